"""The match of a point, weighed against a point that nobody has seen before."""

import math

import numpy as np
import pytest
from predicted import predict_points
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.joint_assignment import Pairs, likely_matches
from sixthsense.slam.association.unknown import UnknownPoints, least_densities
from sixthsense.slam.estimators import make_estimator

ESTIMATORS = ["ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2"]
START = Pose(-1.3, 0.7, 0.4)
OLD = START @ np.array([[3.1, 0.6], [3.4, 1.5]])
NOISE = np.array([[9.0e-5, 2.0e-5], [2.0e-5, 4.0e-5]])


def log_density_given_the_others(pairs, matched, i):
    """Of the innovation of match `i`: the density of all matches over that of all but this."""

    def log_density(rows):
        index = (2 * matched[rows][:, None] + np.arange(2)).ravel()
        S = pairs.predicted[np.ix_(index, index)] + block_diag(*pairs.noise[rows, matched[rows]])
        values = pairs.values[rows, matched[rows]].ravel()
        return multivariate_normal(np.zeros(len(values)), S).logpdf(values) if len(rows) else 0.0

    rows = np.flatnonzero(matched >= 0)
    return log_density(rows) - log_density(rows[rows != i])


def crowd(seed):
    """Four observations and five landmarks whose predictions share the error of a pose; three are matched."""
    rng = np.random.default_rng(seed)
    H = rng.normal(0.0, 0.3, (10, 3))
    root = rng.normal(0.0, 0.04, (4, 5, 2, 2))
    noise = root @ root.transpose(0, 1, 3, 2) + 1e-4 * np.eye(2)
    pairs = Pairs(rng.normal(0.0, 0.15, (4, 5, 2)), noise, H @ H.T + 1e-3 * np.eye(10))
    return pairs, np.array([3, 0, -1, 4])


@pytest.mark.parametrize("seed", range(8))
def test_the_match_that_is_least_likely_given_the_others_is_given_up_just_below_its_density(seed):
    pairs, matched = crowd(seed)
    densities = {i: log_density_given_the_others(pairs, matched, i) for i in (0, 1, 3)}
    worst = min(densities, key=densities.get)
    kept = likely_matches(pairs, matched, np.full(5, densities[worst] - 1e-6))
    assert kept.tolist() == matched.tolist()
    given_up = likely_matches(pairs, matched, np.full(5, densities[worst] + 1e-6))
    assert given_up[worst] == -1
    # The others are judged without it.
    rest = matched.copy()
    rest[worst] = -1
    left = [log_density_given_the_others(pairs, rest, i) for i in densities if i != worst]
    if min(left) > densities[worst] + 1e-6:
        assert given_up.tolist() == rest.tolist()


def test_each_landmark_has_a_limit_of_its_own_and_the_match_goes_first_that_lacks_most():
    pairs, matched = crowd(3)
    densities = {i: log_density_given_the_others(pairs, matched, i) for i in (0, 1, 3)}
    least = np.full(5, -math.inf)  # that of a wall, which still tells how likely the others are
    least[matched[1]] = densities[1] - 1e-6
    assert likely_matches(pairs, matched, least).tolist() == [3, 0, -1, 4]
    least[matched[1]] = densities[1] + 1e-6
    assert likely_matches(pairs, matched, least).tolist() == [3, -1, -1, 4]
    least[matched[0]] = densities[0] + 0.7  # judged first, and without it the other one is likelier or not
    kept = likely_matches(pairs, matched, least)
    rest = np.array([-1, 0, -1, 4])
    stays = log_density_given_the_others(pairs, rest, 1) >= least[0]
    assert kept.tolist() == [-1, 0 if stays else -1, -1, 4]


def test_the_density_of_unknown_points_is_that_of_those_without_a_match_over_the_disc_of_all():
    unknown = UnknownPoints()
    assert unknown.density(np.zeros((0, 2))) == 0.0
    first, second, now = np.array([[1.2, -0.4], [2.1, 3.3]]), np.array([[-3.7, 0.9]]), np.array([[0.3, 2.2]])
    unknown.add(first, np.array([True, True]))
    unknown.add(second, np.array([False]))
    keep = 0.99
    squares = keep * (1.2**2 + 0.4**2 + 2.1**2 + 3.3**2) + 3.7**2 + 0.9**2 + 0.3**2 + 2.2**2
    area = math.pi * 2.0 * squares / (keep * 2 + 2)
    expected = (keep * 2 + 1) / 100.0 / area
    assert unknown.density(now) == pytest.approx(expected, rel=1e-12)


def test_the_least_density_of_a_match_is_that_of_unknown_points_times_the_odds():
    walls = np.array([False, True])
    np.testing.assert_allclose(least_densities(0.03, walls, 50.0), [math.log(1.5), -math.inf])
    assert np.all(least_densities(0.03, walls, 0.0) == -math.inf)
    assert least_densities(0.0, walls, 50.0)[0] == -math.inf


def returned(name, sigma_m, seen, odds=1000.0):
    """What is matched, of points that are `seen` (k, 2) by a robot whose position is uncertain by `sigma_m`.

    It knows two points, has seen no unknown one in 40 keyframes, and has moved.
    """
    estimator = make_estimator(name, START, np.zeros((3, 3)))
    associator = Associator(AssociationConfig(match_odds=odds))
    for _ in range(41):
        estimator.update(associator.associate(sight(START, OLD), estimator).observations)
    estimator.predict(Odometry(Pose(), np.diag([sigma_m**2, sigma_m**2, 1e-8])))
    return associator.associate(sight(START, seen), estimator)


def sight(pose, points):
    return [Observation(Kind.END, z, NOISE) for z in predict_points(pose, points)[0]]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_lone_point_closes_no_loop_from_afar_and_two_that_agree_do(name):
    """The other point that is seen is 0.3 m beside a known one, and passes its gate."""
    off = np.array([0.21, -0.2])
    lone = returned(name, 0.8, OLD[:1] + off)
    assert (lone.dof, len(lone.observations), lone.discarded) == (0, 0, 1)
    assert returned(name, 0.8, OLD[:1] + off, odds=0.0).dof == 2
    both = returned(name, 0.8, OLD + off)
    assert (both.dof, both.discarded) == (4, 0)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_lone_point_is_matched_while_the_place_of_the_robot_is_certain_enough(name):
    """The limit by hand: two new points 40 keyframes ago and one more, over the disc of all."""
    per_keyframe = (2.0 * 0.99**40 + 1.0) / 100.0
    mean_square = (3.1**2 + 0.6**2 + 3.4**2 + 1.5**2) / 2.0  # the point of this keyframe changes it by 1 %
    density = per_keyframe / (2.0 * math.pi * mean_square)
    limit_m = math.sqrt(1.0 / (2.0 * math.pi * 1000.0 * density))
    assert 0.4 < limit_m < 0.9
    assert returned(name, 0.9 * limit_m, OLD[:1]).dof == 2
    assert returned(name, 1.1 * limit_m, OLD[:1]).dof == 0
