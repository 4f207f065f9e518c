"""Short walls far from the start, where a turn of one about its middle moves its offset from the origin."""

import numpy as np
import pytest

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Sighting
from sixthsense.core.motion import Odometry
from sixthsense.evaluation.metrics import nees_band, nees_world
from sixthsense.testing.estimation import make

RUNS, STEPS, STEP_M, REACH_M = 12, 75, 0.4, 4.0
DIRECTION_RAD, OFFSET_M = 0.03, 0.005
MOTION_COV = np.diag([1e-5, 1e-5, 4e-5])


def seen_wall(pose, alpha, middle, rng):
    """A wall through `middle`, seen with a turn about it and a shift."""
    place = (pose.inverse() @ Pose(*middle)).position
    turned = wrap_angle(alpha - pose.theta + DIRECTION_RAD * rng.standard_normal())
    normal, along = np.array([np.cos(turned), np.sin(turned)]), np.array([-np.sin(turned), np.cos(turned)])
    to_foot = np.array([[1.0, 0.0], [along @ place, 1.0]])
    cov = to_foot @ np.diag([DIRECTION_RAD**2, OFFSET_M**2]) @ to_foot.T
    z = np.array([turned, normal @ place + OFFSET_M * rng.standard_normal()])
    return Sighting(Kind.WALL, z, cov, (along @ place - 0.25, along @ place + 0.25))


def end_of_a_corridor(name, seed):
    """Error (3,) of the pose after 30 m past walls of half a metre, and its covariance; all matches are known."""
    rng = np.random.default_rng(seed)
    walls = 45
    alpha, ahead, aside = rng.uniform(-np.pi, np.pi, walls), rng.uniform(0, 30, walls), rng.uniform(-4, 4, walls)
    middles = np.column_stack([ahead, aside])
    estimator, true = make(name, Pose(), np.zeros((3, 3))), Pose()
    for _ in range(STEPS):
        true = true @ Pose(STEP_M)
        error = np.linalg.cholesky(MOTION_COV) @ rng.standard_normal(3)
        estimator.predict(Odometry(Pose(STEP_M + error[0], error[1], error[2]), MOTION_COV))
        near = np.flatnonzero(np.hypot(*(middles - true.position).T) < REACH_M)
        estimator.update({int(i): seen_wall(true, alpha[i], middles[i], rng) for i in near})
    estimate = estimator.estimate()
    error = estimate.pose.array() - true.array()
    error[2] = wrap_angle(error[2])
    return error, estimate.pose_cov


@pytest.mark.parametrize("name", ["ekf-fej", "ekf-oc", "ekf-invariant", "isam2"])
def test_short_walls_leave_the_pose_consistent_however_far_they_are(name):
    errors, covs = (np.array(values) for values in zip(*(end_of_a_corridor(name, k) for k in range(RUNS)), strict=True))
    low, high = nees_band(RUNS, confidence=0.999)
    assert low < nees_world(errors, covs).mean() < high
    # A bias would shift all runs along the corridor.
    sigma = np.sqrt(covs[:, 0, 0].mean() / RUNS)
    assert abs(errors[:, 0].mean()) < 3.3 * sigma
