"""Batch least squares as the reference of the laws: its observation models, and its solution."""

import numpy as np

from sixthsense.core.geometry import wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.testing.batch import batch_posterior, observation_jacobian, to_robot, to_world
from sixthsense.testing.estimators import BOTH, START, START_COV, drive


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


def test_the_batch_solution_does_not_depend_on_the_order_of_a_scans_observations():
    log = drive(BOTH, 6)[0]
    other = [(odometry, dict(reversed(scan.items()))) for odometry, scan in log]
    one, two = (batch_posterior(each, START, START_COV) for each in (log, other))
    assert two.ids == list(other[0][1]) + [i for i in one.ids if i not in other[0][1]]
    index = [0, 1, 2, *(3 + 2 * two.ids.index(i) + n for i in one.ids for n in (0, 1))]
    assert np.allclose(one.mean, two.mean[index], atol=1e-12)
    assert np.allclose(one.cov, two.cov[np.ix_(index, index)], rtol=1e-6, atol=1e-14)
