"""A drive past short walls that are known to be which, seen with an error that a line fit has: a turn and a shift."""

from __future__ import annotations

import numpy as np
from point_world import make

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry

_STEP_M, _REACH_M, _WALLS_PER_M, _ASIDE_M, _LENGTH_M = 0.4, 4.0, 1.5, 4.0, 0.5
_OFFSET_M = 0.005
_MOTION_COV = np.diag([1e-5, 1e-5, 4e-5])
_ROWS_APART = 10  # steps


def drive_past_short_walls(name: str, seed: int, way_m: float, direction_rad: float) -> tuple[Array, Array]:
    """Errors (N, 3) of an estimator's pose every 4 m along a straight way, and their covariances (N, 3, 3).

    The start is known. Walls of half a metre stand within 4 m of the way, in any direction; their observations have the
    sigma `direction_rad` of a turn about the wall's middle, and one of 5 mm of a shift there, which the stated
    covariances are of.
    """
    rng = np.random.default_rng(seed)
    count = int(_WALLS_PER_M * way_m)
    alpha = rng.uniform(-np.pi, np.pi, count)
    middles = np.column_stack([rng.uniform(0.0, way_m, count), rng.uniform(-_ASIDE_M, _ASIDE_M, count)])
    estimator, true = make(name, Pose(), np.zeros((3, 3))), Pose()
    errors, covs = [], []
    for step in range(1, round(way_m / _STEP_M) + 1):
        true = true @ Pose(_STEP_M)
        slip = np.linalg.cholesky(_MOTION_COV) @ rng.standard_normal(3)
        estimator.predict(Odometry(Pose(_STEP_M + slip[0], slip[1], slip[2]), _MOTION_COV))
        near = np.flatnonzero(np.hypot(*(middles - true.position).T) < _REACH_M)
        estimator.update({int(i): _observation(true, float(alpha[i]), middles[i], direction_rad, rng) for i in near})
        if step % _ROWS_APART == 0:
            estimate = estimator.estimate()
            error = estimate.pose.array() - true.array()
            errors.append(np.array([error[0], error[1], wrap_angle(float(error[2]))]))
            covs.append(estimate.pose_cov)
    return np.array(errors), np.array(covs)


def _observation(
    pose: Pose, alpha: float, middle: Array, direction_rad: float, rng: np.random.Generator
) -> Observation:
    """A wall through `middle` (2,) with the normal `alpha`, seen with a turn about its middle and a shift there."""
    turned = wrap_angle(alpha - pose.theta + direction_rad * rng.standard_normal())
    place = rotation(-pose.theta) @ (middle - pose.position)
    ahead, along = (float(value) for value in rotation(-turned) @ place)
    to_foot = np.array([[1.0, 0.0], [along, 1.0]])
    cov = to_foot @ np.diag([direction_rad**2, _OFFSET_M**2]) @ to_foot.T
    z = np.array([turned, ahead + _OFFSET_M * rng.standard_normal()])
    return Observation(Kind.WALL, z, cov, (along - 0.5 * _LENGTH_M, along + 0.5 * _LENGTH_M))
