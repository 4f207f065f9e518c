"""Known walls that a scan sees through contradict the matches of an uncertain robot."""

import math

import numpy as np
import pytest

from sixthsense.config import AssociationConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.loop.run import run
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.matching import Usual, compare, match
from sixthsense.slam.association.observed import Observed
from sixthsense.slam.association.seen_through import Returns, lengths_seen, offset_variances
from sixthsense.slam.association.unknown import UnknownDensity
from sixthsense.slam.estimators import make_estimator
from sixthsense.testing.sight import predict_points, predict_walls

ESTIMATORS = ["ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2"]
START = Pose(-1.3, 0.7, 0.4)
COV = np.array([[4e-5, 1e-5], [1e-5, 1e-4]])
NO_COV = np.zeros((1, 2, 2))
AHEAD = np.array([[0.5 * math.pi, 2.1]])  # the line y = 2.1, which is seen from (0.4, 0.1)
BEHIND = np.column_stack([[-1.6, -0.6, 0.4, 1.4], np.full(4, 4.1)])  # beams cross it at -0.6, -0.1, 0.4 and 0.9
LASER = np.array([0.4, 0.1])


def seen_through(points, first, last, cov=NO_COV, along_m=0.0, gate=13.8):
    """(2, 3): through it and of it, with its ends 2 sigmas to either side and where they are."""
    extents = np.array([[[first, 2.1], [last, 2.1]]])
    return lengths_seen(Returns(LASER, points), AHEAD, cov, extents, along_m, gate)[0]


def through(*args, **options):
    found = seen_through(*args, **options)
    assert found[0, 0] == found[0, 1] == found[0, 2]
    return float(found[0, 1])


def test_the_length_is_that_of_the_known_wall_between_the_crossings_of_neighbouring_beams():
    assert through(BEHIND, -3.0, 3.0) == pytest.approx(1.5)
    assert through(BEHIND[::-1], 3.0, -3.0) == pytest.approx(1.5)
    assert through(BEHIND, -3.0, 0.5) == pytest.approx(1.1)
    before = BEHIND.copy()
    before[1, 1] = 1.9  # an obstacle hides the wall: nothing is known between its neighbours
    assert through(before, -3.0, 3.0) == pytest.approx(0.5)
    assert through(BEHIND[:1], -3.0, 3.0) == 0.0
    assert not seen_through(BEHIND - [0.0, 3.0], -3.0, 3.0).any()


def test_what_is_seen_of_a_wall_is_where_the_returns_are():
    on_it = BEHIND.copy()
    on_it[:3, 1] = [2.13, 2.08, 2.06]  # within the noise of ends; the fourth is behind
    np.testing.assert_allclose(seen_through(on_it, -3.0, 3.0), [[0.0] * 3, [2.0] * 3])
    np.testing.assert_allclose(seen_through(on_it, -1.0, 3.0), [[0.0] * 3, [1.4] * 3])
    on_it[0] = BEHIND[1] - [0.4, 0.0]  # two behind, which cross at -0.3 and -0.1
    on_it[1] = BEHIND[1]
    on_it[2] = [0.4, 2.1]
    np.testing.assert_allclose(seen_through(on_it, -3.0, 3.0), [[0.2] * 3, [0.0] * 3], atol=1e-12)


def test_the_wall_may_lie_two_sigmas_further_along_its_line():
    # Two sigmas of 0.1 m: the wall ends at 0.7, 0.5 or 0.3, or begins at -0.3, -0.5 or -0.7; its tangent is -x.
    assert seen_through(BEHIND, -3.0, 0.5, along_m=0.1)[0] == pytest.approx([1.3, 1.1, 0.9])
    assert seen_through(BEHIND, -0.5, 3.0, along_m=0.1)[0] == pytest.approx([1.2, 1.4, 1.5])
    on_it = BEHIND * [1.0, 0.0] + [0.0, 2.1]
    assert seen_through(on_it, -3.0, 0.5, along_m=0.1)[1] == pytest.approx([2.3, 2.1, 1.9])


def test_a_return_is_behind_a_wall_beyond_the_gate_and_the_noise_of_ends():
    near = BEHIND.copy()
    near[:, 1] = 2.16
    assert through(near, -3.0, 3.0) > 2.5 and through(near - [0.0, 0.011], -3.0, 3.0) == 0.0
    cov = np.array([[[0.0, 0.0], [0.0, 0.016**2]]])  # 3.715 sigmas of it are 0.0594 m
    assert through(near, -3.0, 3.0, cov) > 2.5 and through(near - [0.0, 0.001], -3.0, 3.0, cov) == 0.0
    turns = np.array([[[0.02**2, 0.0], [0.0, 0.0]]])  # 0.02 rad at 0.9 m are 0.018 m; beams cross at up to 1.37 m
    assert 0.0 < through(near, -3.0, 3.0, turns) < 2.0
    # The wall turns about x = -1.3: 0.0594 m are 0.8 m from there, between the second and the third crossing.
    about = 0.02**2 * np.array([[[1.0, 1.3], [1.3, 1.69]]])
    assert through(near, -3.0, 3.0, about) == pytest.approx(2.0 / 2.06)


def test_the_variance_of_an_offset_is_that_of_drawn_walls():
    rng = np.random.default_rng(4)
    line, cov = np.array([2.3, 1.7]), np.array([[3.0e-6, 2.0e-6], [2.0e-6, 5.0e-6]])
    place = line[1] * np.array([math.cos(2.3), math.sin(2.3)]) + 2.6 * np.array([-math.sin(2.3), math.cos(2.3)])
    angles, offsets = rng.multivariate_normal(line, cov, 20_000).T
    drawn = np.cos(angles) * place[0] + np.sin(angles) * place[1] - offsets
    found = offset_variances(line[None], cov[None], place[None])
    assert found == pytest.approx(np.var(drawn), rel=0.04)  # 4 sigmas of 20,000 draws


def uncertain(name, sigmas=(0.4, 0.4, 0.01), extent=(-1.9, 1.2)):
    """An estimator that knows a wall and two points, and then moves with sigmas; the wall, world frame."""
    walls, points = np.array([[0.9, 2.6]]), START @ np.array([[1.4, -2.0], [2.2, -1.7]])
    estimator, associator = make_estimator(name, START, np.zeros((3, 3))), Associator(AssociationConfig())
    shown = seen(START, walls, extent) + ends_of(START, points)
    estimator.update(associator.associate(shown, estimator).observations)
    estimator.predict(Odometry(Pose(0.1, -0.05, 0.02), np.diag(sigmas) ** 2))
    return estimator, associator, walls


def seen(pose, walls, extent):
    return [Observation(Kind.WALL, z, COV, extent) for z in predict_walls(pose, walls)[0]]


def ends_of(pose, points):
    return [Observation(Kind.END, z, 1e-4 * np.eye(2)) for z in predict_points(pose, points)[0]]


def beyond(pose, walls, metres, first, last):
    """Returns so far behind a wall, from place to place along it, robot's frame; the laser is in the middle."""
    ((angle, offset),) = predict_walls(pose, walls)[0]
    normal, along = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    places = np.linspace(first, last, 12)[:, None]
    return Returns(np.zeros(2), (offset + math.copysign(metres, offset)) * normal + places * along)


NEARER = np.array([0.0, 0.3])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_uncertain_robot_matches_no_piece_of_wall_with_which_it_would_see_through_the_rest(name):
    estimator, associator, walls = uncertain(name)
    pose = estimator.estimate().pose
    piece = seen(pose, walls - NEARER, (-0.7, -0.1))
    # 0.25 m behind the piece is 0.05 m before the wall: it is behind where the match puts the robot.
    through = beyond(pose, walls - NEARER, 0.25, 0.0, 1.2)
    on_it, little = beyond(pose, walls - NEARER, 0.0, -1.4, -0.1), beyond(pose, walls - NEARER, 0.25, 0.0, 0.3)
    more_of_it = Returns(through.laser, np.vstack([on_it.points, through.points]))
    for returns in (None, on_it, little, more_of_it):
        assert list(associator.associate(piece, estimator, returns=returns).observations) == [0]
    # It may still be this wall, so it is no other one either.
    assert not associator.associate(piece, estimator, returns=through).observations


@pytest.mark.parametrize("name", ESTIMATORS)
def test_matches_by_which_the_robot_sees_through_no_wall_stay(name):
    estimator, associator, walls = uncertain(name)
    pose = estimator.estimate().pose
    fresh = pose @ np.array([[1.5, 0.8], [-0.8, 0.7]])  # begun where the robot is uncertain
    estimator.update(associator.associate(ends_of(pose, fresh), estimator).observations)
    shown = ends_of(pose, fresh) + seen(pose, walls - NEARER, (-0.7, -0.1))
    through = beyond(pose, walls - NEARER, 0.25, 0.0, 1.2)
    assert list(associator.associate(shown, estimator, returns=through).observations) == [3, 4]


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("sigmas", [(0.02, 0.02, 0.01), (0.02, 0.02, 0.05)])
def test_what_lies_behind_a_wall_changes_no_match_that_is_certain(name, sigmas):
    """The heading moves the ends of a wall, and not its middle."""
    estimator, associator, walls = uncertain(name, sigmas, (-4.0, 4.2))
    pose = estimator.estimate().pose
    piece = seen(pose, walls, (-0.4, 0.2))
    through = beyond(pose, walls, 0.4, 0.3, 1.5)
    assert list(associator.associate(piece, estimator, returns=through).observations) == [0]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_wall_ends_where_the_matches_say(name):
    """A point that is matched says that the robot is 0.4 m further along; what it sees lies past the wall's end."""
    estimator, associator, walls = uncertain(name)
    estimate = estimator.estimate()
    true = estimate.pose @ Pose(*(0.4 * np.array([-math.sin(0.5), math.cos(0.5)])), 0.0)  # along a wall at 0.92 rad
    shown = ends_of(true, estimate.landmarks[~estimate.walls]) + seen(true, walls, (-0.7, -0.1))
    past = beyond(true, walls, 0.4, 0.85, 1.25)
    assert sorted(associator.associate(shown, estimator, returns=past).observations) == [0, 1, 2]


@pytest.mark.parametrize(("sigma_m", "is_matched"), [(0.02, False), (0.055, True)])
def test_a_return_behind_a_crooked_wall_may_be_of_it(sigma_m, is_matched):
    estimator, associator, walls = uncertain("ekf")
    estimate = estimator.estimate()
    observed = Observed.of(seen(estimate.pose, walls - NEARER, (-0.7, -0.1)))
    through = beyond(estimate.pose, walls - NEARER, 0.25, 0.0, 1.2)
    extents = np.array([associator.records[i].extent for i in estimate.ids.tolist()])
    usual = Usual((0.0, 0.0), sigma_m**2, 0.0, UnknownDensity(0.0, 0.0))
    found = match(observed, estimator, estimate, extents, associator.records, usual, AssociationConfig(), through)
    assert (found.landmark[0] == 0) == is_matched and not found.is_new[0]


@pytest.mark.parametrize("seed", range(4))
def test_predictions_given_matches_are_those_of_gaussians_that_are_conditioned(seed):
    rng = np.random.default_rng(seed)
    estimator, _, walls = uncertain("ekf", (0.1, 0.1, 0.01))
    estimate = estimator.estimate()
    pose = estimate.pose
    shown = seen(pose, walls + rng.normal(0.0, 0.02, (1, 2)), (-0.7, 0.9))
    shown += [Observation(Kind.END, z + rng.normal(0.0, 0.05, 2), 1e-4 * np.eye(2))
              for z in predict_points(pose, estimate.landmarks[~estimate.walls])[0]]  # fmt: skip
    near, joint = np.arange(3), estimator.joint_covariance(estimate.ids.tolist())
    innovations = compare(Observed.of(shown), np.zeros(3), estimate, near, joint)
    rows = {int(i): k for k, i in enumerate(estimate.ids)}
    matched = np.array([rows[0], -1, rows[2]])
    P = np.block([[innovations.pairs.predicted, innovations.with_pose],
                  [innovations.with_pose.T, joint[:3, :3]]])  # fmt: skip
    cols = np.concatenate([[2 * matched[i], 2 * matched[i] + 1] for i in (0, 2)])
    noise, values = np.zeros((4, 4)), np.concatenate([innovations.pairs.values[i, matched[i]] for i in (0, 2)])
    noise[:2, :2], noise[2:, 2:] = (innovations.pairs.noise[i, matched[i]] for i in (0, 2))
    gain = P[:, cols] @ np.linalg.inv(P[np.ix_(cols, cols)] + noise)
    mean, cov = gain @ values, P - gain @ P[cols]
    predicted, covs, fall = innovations.given(matched)
    np.testing.assert_allclose(predicted.ravel(), innovations.predicted.ravel() + mean[:6], atol=1e-12)
    for k in range(3):
        np.testing.assert_allclose(covs[k], cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], atol=1e-12)
        np.testing.assert_allclose(innovations.own[k], P[2 * k : 2 * k + 2, 2 * k : 2 * k + 2])
    np.testing.assert_allclose(joint[:3, :3] - fall, cov[6:, 6:], atol=1e-12)
    none = innovations.given(np.full(3, -1))
    np.testing.assert_allclose(none[0], innovations.predicted)
    assert not none[2].any()


def test_the_returns_are_those_of_the_keyframe_in_the_robots_frame(monkeypatch):
    given, associate = [], Associator.associate

    def kept(self, observations, estimator, proposed=None, returns=None):
        given.append((observations, returns))
        return associate(self, observations, estimator, proposed, returns)

    monkeypatch.setattr(Associator, "associate", kept)
    mount = (0.11, -0.04, 0.7)
    run(preset(scene="apartment", task="explore", max_time=4.0, laser={"mount": mount, "max_range": 3.0}))
    assert len(given) > 2
    for observations, (laser, points) in given:
        assert laser == pytest.approx(mount[:2]) and np.isfinite(points).all() and len(points) > 50
        assert 2.0 < np.linalg.norm(points - laser, axis=1).max() < 3.0 + 1e-6
        for wall in (one for one in observations if one.is_wall):  # of which the returns are
            angle, offset = wall.z
            off = points @ [math.cos(angle), math.sin(angle)] - offset
            assert np.count_nonzero(np.abs(off) < 0.1) > 5
