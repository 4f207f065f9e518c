"""What the odometry since the last key scan says, with errors of wheels that its noise does not state."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry
from sixthsense.slam.scans.tracking import SLIP_SIGMAS, Prior

# Wheels are wrong by a few percent, always to the same side: sigmas grow with the way, not with its square root.
_SIGMA_M, _M_PER_M = 0.01, 0.05
_SIGMA_RAD, _RAD_PER_RAD, _RAD_PER_M = 0.005, 0.05, 0.02


def has_slipped(slip: float) -> bool:
    """Whether the scans contradict the odometry, by the squared Mahalanobis distance between them."""
    return slip > SLIP_SIGMAS**2


def with_wheel_errors(odometry: Odometry) -> Odometry:
    """Odometry whose covariance has systematic errors of the wheels added."""
    distance, turn = math.hypot(odometry.motion.x, odometry.motion.y), abs(odometry.motion.theta)
    position = (_SIGMA_M + _M_PER_M * distance) ** 2
    heading = (_SIGMA_RAD + _RAD_PER_RAD * turn + _RAD_PER_M * distance) ** 2
    cov = odometry.cov.copy()
    cov[0, 0] += position
    cov[1, 1] += position
    cov[2, 2] += heading
    return Odometry(odometry.motion, cov)


def weakened(odometry: Odometry, slip: float) -> Odometry:
    """Odometry that the scans have contradicted by the squared Mahalanobis distance `slip`."""
    return Odometry(odometry.motion, odometry.cov * (1.0 + slip / SLIP_SIGMAS**2))


def prior_of(key_pose: Array, odometry: Odometry) -> Prior:
    """The prior of a pose, from that of the last key scan (3,), world frame, and the odometry since then."""
    pose = Pose.from_array(key_pose)
    return Prior((pose @ odometry.motion).array(), informations_in_world(key_pose[None], odometry.cov[None])[0])


def informations_in_world(key_poses: Array, covs: Array) -> Array:
    """(m, 3, 3) informations, world axes, of motions with covariances (m, 3, 3), axes of the key poses (m, 3)."""
    c, s = np.cos(key_poses[:, 2]), np.sin(key_poses[:, 2])
    turn = np.zeros((len(key_poses), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    return np.asarray(np.linalg.inv(turn @ covs @ turn.transpose(0, 2, 1)))
