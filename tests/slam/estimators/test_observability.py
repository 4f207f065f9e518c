"""Position and heading of the whole map are unobservable: which filters gain information about them."""

import numpy as np
import pytest
from point_world import CONSISTENT, START, START_COV, joint_state, make, noisy, step

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.batch import to_robot
from sixthsense.testing.estimators import BOTH
from sixthsense.testing.observability import heading_variances, nullity, observability_gramian

FILTERS = [name for name in ESTIMATORS if name != "isam2"]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("name", "expected"), [(n, 2 if n == "ekf" else 3) for n in FILTERS])
def test_the_standard_filter_observes_the_heading_of_the_world_and_the_others_do_not(name, expected, seed):
    assert nullity(observability_gramian(name, seed, noise=True)) == expected


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CONSISTENT)
def test_the_heading_variance_never_falls_below_that_of_the_start(name, seed):
    """No measurement depends on the world's axes."""
    assert heading_variances(name, seed).min() > 1.0


@pytest.mark.parametrize("seed", range(3))
def test_the_standard_filters_heading_variance_falls_below_that_of_the_start(seed):
    """The known inconsistency: the variance falls to 0.22 to 0.32 of a value that no measurement can lower."""
    assert heading_variances("ekf", seed).min() < 0.5


def information_about_the_maps_position(name, seed, steps=20):
    """(steps, 2, 2) information about a translation of the whole map of points and walls, all else being equal.

    N^T cov^-1 N with N the translation of the pose, the points and the walls' offsets; the first is that of the start.
    """
    rng, true = np.random.default_rng(seed), START
    cov = np.diag([0.02, 0.02]) ** 2
    estimator, found = make(name), [np.linalg.inv(START_COV)[:2, :2]]
    for _ in range(steps):
        true = true @ noisy(step(), rng)
        estimator.predict(step())
        observations = {}
        for i, kind in enumerate(BOTH.kinds):
            z = to_robot(true.array(), BOTH.landmarks[i], kind == Kind.WALL) + 0.02 * rng.standard_normal(2)
            observations[i] = Observation(kind, z, cov, (-1.0, 1.0))
        estimator.update(observations)
        estimate, joint = joint_state(estimator)
        N = np.zeros((len(joint), 2))
        N[:2] = np.eye(2)
        for k, (landmark, is_wall) in enumerate(zip(estimate.landmarks, estimate.walls, strict=True)):
            normal = np.array([[0.0, 0.0], [np.cos(landmark[0]), np.sin(landmark[0])]])
            N[3 + 2 * k : 5 + 2 * k] = normal if is_wall else np.eye(2)
        found.append(N.T @ np.linalg.solve(joint, N))
    return np.array(found)


def gains(information):
    """(steps,) largest ratio, over directions, of the later information to that of the start."""
    root = np.linalg.cholesky(information[0])
    whitened = [np.linalg.solve(root, np.linalg.solve(root, later).T) for later in information[1:]]
    return np.array([np.linalg.eigvalsh(each)[-1] for each in whitened])


@pytest.mark.parametrize("seed", range(5))
def test_the_invariant_filter_gains_no_information_about_the_maps_position_from_walls(seed):
    assert gains(information_about_the_maps_position("ekf-invariant", seed)).max() < 1.0 + 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_the_standard_filter_gains_information_about_the_maps_position_from_walls(seed):
    """No measurement has any, so that it becomes overconfident, the more the less certain the start."""
    assert gains(information_about_the_maps_position("ekf", seed)).max() > 1.5
