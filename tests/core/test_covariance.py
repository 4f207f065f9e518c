"""Covariances under motions of the plane: the kernels agree with products of matrices."""

import math

import numpy as np

from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.core.se2 import composed_covariance, transformed_covariance, turned_covariance

RNG = np.random.default_rng(0)


def covariance() -> Array:
    factor = RNG.normal(size=(3, 3))
    return factor @ factor.T


def test_a_root_is_accurate_where_one_direction_is_known_and_another_is_not():
    variances = np.array([1e-6, 1e-5, 1e4])
    for _ in range(20):
        axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
        covs = np.array([(axes * variances) @ axes.T, covariance()])
        root = root_information(covs)
        whitened = root[0] @ (axes * np.sqrt(variances))
        assert np.allclose(whitened.T @ whitened, np.eye(3), atol=1e-4)
        assert np.allclose(root[1].T @ root[1], np.linalg.inv(covs[1]))


def test_a_covariance_is_transformed_by_the_jacobian():
    for _ in range(20):
        cov, angle, (u, v) = covariance(), RNG.uniform(-4, 4), RNG.normal(size=2)
        c, s = math.cos(angle), math.sin(angle)
        jacobian = np.array([[c, -s, u], [s, c, v], [0.0, 0.0, 1.0]])
        assert np.allclose(transformed_covariance(cov, c, s, u, v), jacobian @ cov @ jacobian.T)
        turned = turned_covariance(cov, angle)
        assert np.array_equal(turned, turned.T)
        turn = Pose(theta=angle).adjoint()
        assert np.allclose(turned, turn @ cov @ turn.T)


def test_covariances_of_motions_in_a_row_are_composed_by_their_jacobians():
    for _ in range(20):
        first, later, heading, motion = covariance(), covariance(), RNG.uniform(-3, 3), Pose(*RNG.normal(size=3))
        by_first, by_later = compose_jacobians(heading, motion)
        found = composed_covariance(first, later, heading, motion.x, motion.y)
        assert np.allclose(found, by_first @ first @ by_first.T + by_later @ later @ by_later.T)


def test_a_standstill_before_or_after_a_motion_leaves_it_as_it_is():
    motion = Odometry(Pose(0.3, -0.1, 0.2), covariance())
    for same in (motion.then(STANDSTILL), STANDSTILL.then(motion)):
        assert same.motion == motion.motion and np.array_equal(same.cov, motion.cov)
