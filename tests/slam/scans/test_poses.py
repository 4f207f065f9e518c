"""Arrays of poses, and informations of odometry in the world: the kernels agree with poses and matrices."""

import numpy as np
import pytest

from sixthsense.core.geometry import Pose, rotation, wrap_angle
from sixthsense.core.pose_kernels import wrapped
from sixthsense.slam.scans.odometry_prior import informations_in_world
from sixthsense.slam.scans.poses import between, compose

RNG = np.random.default_rng(0)
ONE, MANY = RNG.uniform(-4, 4, size=3), RNG.uniform(-4, 4, size=(7, 3))


@pytest.mark.parametrize(("a", "b"), [(ONE, MANY), (MANY, ONE), (MANY, MANY[::-1]), (ONE, MANY[0]), (ONE, MANY[:0])])
def test_rows_of_poses_are_composed_as_poses(a, b):
    rows = np.broadcast_shapes(a.shape, b.shape)
    pairs = list(zip(np.broadcast_to(a, rows).reshape(-1, 3), np.broadcast_to(b, rows).reshape(-1, 3), strict=True))
    composed = [(Pose.from_array(x) @ Pose.from_array(y)).array() for x, y in pairs]
    relative = [(Pose.from_array(x).inverse() @ Pose.from_array(y)).array() for x, y in pairs]
    for found, expected in ((compose(a, b), composed), (between(a, b), relative)):
        off = found - np.array(expected).reshape(rows)
        off[..., 2] = wrap_angle(off[..., 2])
        assert found.shape == rows and np.abs(off).max(initial=0.0) < 1e-12
        assert ((found[..., 2] >= -np.pi) & (found[..., 2] < np.pi)).all()


@pytest.mark.parametrize("angle", [0.3, -3.2, 7.0, np.pi, -np.pi, 3 * np.pi, -np.pi - 1e-17, np.nextafter(-np.pi, -4)])
def test_an_angle_is_wrapped_as_everywhere_else(angle):
    assert wrapped(angle) == wrap_angle(angle)


def test_informations_are_inverses_of_covariances_in_the_worlds_axes():
    factors = RNG.normal(size=(7, 3, 3)) * [[0.1], [0.03], [0.01]]
    covs = factors @ factors.transpose(0, 2, 1) + 1e-5 * np.eye(3)
    turn = np.zeros((7, 3, 3))
    turn[:, 2, 2] = 1.0
    for k in range(7):
        turn[k, :2, :2] = rotation(MANY[k, 2])
    expected = np.linalg.inv(turn @ covs @ turn.transpose(0, 2, 1))
    assert np.allclose(informations_in_world(MANY, covs), expected, rtol=1e-9)
