"""The kernels of the association compute what plain NumPy does."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from sixthsense.core.geometry import Pose
from sixthsense.core.landmark_kernels import innovations_of, predictions, stacked
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.association.innovations import compare
from sixthsense.slam.association.observed import Observed
from sixthsense.slam.association.records import unit_cov
from sixthsense.slam.estimators.base import Estimate

WALLS = np.array([True, False, True, False])
SQUARES = np.array([1e-4, 0.0, 0.0, 0.0])


@pytest.fixture(params=range(4))
def case(request):
    rng = np.random.default_rng(request.param)
    pose, landmarks = Pose(*rng.normal(size=3)), rng.normal(size=(4, 2))
    root = rng.normal(size=(11, 11)) * 0.1
    joint = root @ root.T
    estimate = Estimate(pose, joint[:3, :3], np.arange(4), landmarks, WALLS)
    own = rng.normal(size=(4, 2, 2)) * 0.1
    covs = own @ own.transpose(0, 2, 1)
    z, _, _ = predictions(pose.triple(), landmarks, WALLS)
    seen = [
        Observation(Kind.WALL if wall else Kind.END, z[k] + 0.1 * rng.normal(size=2), covs[k], (0.5, 2.0))
        for k, wall in enumerate(WALLS)
    ]
    return seen, estimate, joint


def pairwise(seen, estimate, joint):
    """Innovations of all pairs, their covariances, those of the predictions and these with the pose."""
    z, by_pose, by_landmark = predictions(estimate.pose.triple(), estimate.landmarks, estimate.walls)
    H = stacked(by_pose, by_landmark, 3)
    n, found = len(z), []
    for observation in seen:
        off = [square * unit_cov(*observation.extent, observation.is_wall) for square in SQUARES]
        less = observation.cov + np.array(off)
        found.append(innovations_of(np.tile(observation.z, (n, 1)), less, z, estimate.walls))
    return (*map(np.array, zip(*found, strict=True)), H @ joint @ H.T, H @ joint[:, :3])


def test_innovations_of_all_pairs(case):
    seen, estimate, joint = case
    found = compare(Observed.of(seen), SQUARES, estimate, np.arange(4), joint)
    values, noise, predicted, with_pose = pairwise(*case)
    assert np.allclose(found.pairs.values, values)
    assert np.allclose(found.pairs.noise, noise)
    assert np.allclose(found.pairs.predicted, predicted)
    assert np.allclose(found.with_pose, with_pose)
    for i in range(4):
        for j in range(4):
            S = predicted[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] + noise[i, j]
            assert found.squared[i, j] == pytest.approx(values[i, j] @ np.linalg.solve(S, values[i, j]))
            assert found.log_det[i, j] == pytest.approx(np.linalg.slogdet(S).logabsdet)


def test_the_pose_and_the_squared_innovation_of_matches_together(case):
    seen, estimate, joint = case
    found = compare(Observed.of(seen), SQUARES, estimate, np.arange(4), joint)
    values, noise, predicted, with_pose = pairwise(*case)
    rows, cols = np.array([0, 1, 3]), np.array([2, 1, 3])
    index = (2 * cols[:, None] + np.arange(2)).ravel()
    y, S = values[rows, cols].ravel(), predicted[np.ix_(index, index)] + block_diag(*noise[rows, cols])
    gain = np.linalg.solve(S, y)
    pose = found.pose_given(estimate.pose, np.array([2, 1, -1, 3]))
    assert np.allclose(pose.array(), Pose.from_array(estimate.pose.array() + gain @ with_pose[index]).array())
    assert found.nis([seen[i] for i in rows], cols) == pytest.approx(y @ gain)
    assert found.worth(np.array([2, 1, -1, 3]), 11.0) == pytest.approx(33.0 - y @ gain)


def test_the_innovation_of_one_wall_and_what_a_square_metre_adds_to_its_covariance(case):
    seen, estimate, joint = case
    found = compare(Observed.of(seen), SQUARES, estimate, np.arange(4), joint)
    values, noise, predicted, _ = pairwise(*case)
    for i in (0, 2):
        value, cov, added = found.innovation(seen[i], 2)
        assert np.allclose(value, values[i, 2]) and np.allclose(cov, predicted[4:6, 4:6] + noise[i, 2])
        assert np.array_equal(added, unit_cov(0.5, 2.0, True))
