"""Covariances of motions, whose errors are in the axes of the frames in which they end, by numerical derivatives."""

from collections.abc import Callable

import numpy as np
from scipy.stats import chi2

from sixthsense.core.covariance import chi_square_quantile, root_information
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry, propagated
from sixthsense.core.se2 import conjugate, move_covariance

RNG = np.random.default_rng(0)


def covariance() -> Array:
    factor = RNG.normal(size=(3, 3))
    return factor @ factor.T


def pose() -> Pose:
    return Pose(*RNG.normal(size=3))


def by_end(function: Callable[[Pose], Pose], motion: Pose) -> Array:
    """(3, 3) how the end of what a function makes of a motion moves in its own axes with the motion's end in its."""
    moved = [(function(motion).inverse() @ function(motion @ Pose.from_array(d))).array() for d in 1e-6 * np.eye(3)]
    return np.array(moved).T / 1e-6


def test_the_motion_of_a_frame_fixed_to_another_one_has_its_covariance_moved_there():
    for _ in range(20):
        mount, motion, cov = pose(), pose(), covariance()
        conjugated = mount @ motion @ mount.inverse()
        assert np.allclose(conjugate(mount.triple(), motion.triple()), conjugated.array(), atol=1e-12)
        by = by_end(lambda m, mount=mount: mount @ m @ mount.inverse(), motion)
        moved = move_covariance(mount.triple(), cov)
        assert np.allclose(moved, by @ cov @ by.T, rtol=1e-4, atol=1e-4) and np.array_equal(moved, moved.T)


def test_motions_in_a_row_and_back_have_the_covariances_of_their_ends():
    for _ in range(20):
        first, later = Odometry(pose(), covariance()), Odometry(pose(), covariance())
        by_first = by_end(lambda m, later=later: m @ later.motion, first.motion)
        found = first.then(later)
        assert found.motion == first.motion @ later.motion
        assert np.allclose(found.cov, by_first @ first.cov @ by_first.T + later.cov, rtol=1e-4, atol=1e-4)
        by = by_end(Pose.inverse, first.motion)
        assert first.inverse().motion == first.motion.inverse()
        assert np.allclose(first.inverse().cov, by @ first.cov @ by.T, rtol=1e-4, atol=1e-4)


def test_the_covariance_of_a_pose_after_a_motion_has_world_axes():
    for _ in range(20):
        start, motion, cov = pose(), Odometry(pose(), covariance()), covariance()
        turned = Odometry(start, move_covariance((0.0, 0.0, -start.theta), cov)).then(motion)
        to_world = Pose(theta=turned.motion.theta).adjoint()
        assert np.allclose(propagated(start, cov, motion), to_world @ turned.cov @ to_world.T)


def test_a_root_is_accurate_where_one_direction_is_known_and_another_is_not():
    variances = np.array([1e-6, 1e-5, 1e4])
    for _ in range(20):
        axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
        covs = np.array([(axes * variances) @ axes.T, covariance()])
        root = root_information(covs)
        whitened = root[0] @ (axes * np.sqrt(variances))
        assert np.allclose(whitened.T @ whitened, np.eye(3), atol=1e-4)
        assert np.allclose(root[1].T @ root[1], np.linalg.inv(covs[1]))


def test_quantiles_are_those_of_scipy_to_the_last_bit():
    dof = np.arange(1, 300)
    for probability in (0.025, 0.5, 0.95, 0.999, 0.999999, 1.0):
        assert np.array_equal(chi_square_quantile(probability, dof), chi2.ppf(probability, dof))
        assert chi_square_quantile(probability, 3) == chi2.ppf(probability, 3)
