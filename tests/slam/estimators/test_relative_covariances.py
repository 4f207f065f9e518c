"""Covariances of key poses relative to each other, against a dense least-squares solution with numerical Jacobians."""

import numpy as np
import pytest

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import between, compose
from sixthsense.slam.estimators import Link
from sixthsense.slam.estimators.isam2 import ISAM2

STEPS = np.array([[1.3, -0.2, 0.7], [0.8, 0.4, -1.1], [1.7, 0.1, 0.5], [0.6, -0.5, 1.9]])
LINKS = ((0, 2), (1, 4), (0, 3))


def cov_of(rng):
    root = np.diag([0.04, 0.02, 0.015]) @ rng.normal(size=(3, 3))
    return root @ root.T + np.diag([2e-5, 3e-5, 1e-5])


def jacobian(function, at, step=1e-6):
    found = []
    for k in range(at.size):
        h = np.zeros(at.size)
        h[k] = step
        off = function(at + h.reshape(at.shape)) - function(at - h.reshape(at.shape))
        off[..., 2] = wrap_angle(off[..., 2])
        found.append(off.ravel() / (2 * step))
    return np.array(found).T


@pytest.fixture
def solved():
    rng = np.random.default_rng(5)
    start = Pose(-2.1, 0.7, 2.4)
    estimator = ISAM2(start, np.diag([3e-4, 2e-4, 1e-4]), ISAM2Config())
    poses, measured = [start.array()], []
    estimator.update({})
    for k, step in enumerate(STEPS):
        poses.append(compose(poses[-1], step))
        measured.append((k, k + 1, cov_of(rng)))
        estimator.predict(Odometry(Pose(*step), measured[-1][2]))
        estimator.update({})
    poses = np.array(poses)
    for a, b in LINKS:
        measured.append((a, b, cov_of(rng)))
    estimator.link([Link(a, b, Odometry(Pose(*between(poses[a], poses[b])), cov)) for a, b, cov in measured[4:]])
    return estimator, poses, measured


def test_a_pose_relative_to_another_is_as_certain_as_a_dense_solution_says(solved):
    estimator, poses, measured = solved
    ends = np.array([(a, b) for a, b, _ in measured])

    def off(free, ends):
        """Errors of the motions between poses, axes of their ends."""
        found = np.vstack([poses[:1], free])
        return between(between(poses[ends[:, 0]], poses[ends[:, 1]]), between(found[ends[:, 0]], found[ends[:, 1]]))

    by_poses = jacobian(lambda free: off(free, ends), poses[1:]).reshape(len(measured), 3, -1)
    information = sum(j.T @ np.linalg.inv(cov) @ j for j, (_, _, cov) in zip(by_poses, measured, strict=True))
    joint = np.linalg.inv(information)
    pairs = np.array([[0, 4], [3, 1], [2, 3]])
    for pair, found in zip(pairs, estimator.relative_covariances(pairs), strict=True):
        by = jacobian(lambda free, pair=pair: off(free, pair[None]), poses[1:])
        np.testing.assert_allclose(found, by @ joint @ by.T, rtol=1e-5, atol=1e-10)
