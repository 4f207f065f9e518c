"""Batch least squares as the reference of the laws: its observation models."""

import numpy as np

from sixthsense.core.geometry import wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.testing.batch import observation_jacobian, to_robot, to_world


def apart(one, other, is_wall):
    off = one - other
    return np.array([wrap_angle(float(off[0])), off[1]]) if is_wall else off


def test_the_reference_has_the_observation_model_of_the_package():
    """Written twice, once by formulae and once by geometry; Jacobians by formulae and by differences."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        pose = rng.uniform(-3, 3, 3)
        for is_wall in (False, True):
            landmark = rng.uniform(-3, 3, 2)
            walls = np.array([is_wall])
            z, by_pose, by_landmark = predictions(tuple(pose), landmark[None], walls)
            found = to_robot(pose, landmark, is_wall)
            assert np.abs(apart(found, z[0], is_wall)).max() < 1e-12
            expected = np.hstack([by_pose[0], by_landmark[0]])
            assert np.allclose(observation_jacobian(pose, landmark, is_wall), expected, atol=1e-8)
            back = to_world(pose, found, is_wall)
            assert np.abs(apart(back, landmark, is_wall)).max() < 1e-12
