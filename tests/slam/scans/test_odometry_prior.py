"""Informations of odometry in the world: the kernel agrees with matrices."""

import numpy as np

from sixthsense.core.geometry import rotation
from sixthsense.slam.scans.odometry_prior import informations_in_world

RNG = np.random.default_rng(0)
MANY = RNG.uniform(-4, 4, size=(7, 3))


def test_informations_are_inverses_of_covariances_in_the_worlds_axes():
    factors = RNG.normal(size=(7, 3, 3)) * [[0.1], [0.03], [0.01]]
    covs = factors @ factors.transpose(0, 2, 1) + 1e-5 * np.eye(3)
    turn = np.zeros((7, 3, 3))
    turn[:, 2, 2] = 1.0
    for k in range(7):
        turn[k, :2, :2] = rotation(MANY[k, 2])
    expected = np.linalg.inv(turn @ covs @ turn.transpose(0, 2, 1))
    assert np.allclose(informations_in_world(MANY, covs), expected, rtol=1e-9)
