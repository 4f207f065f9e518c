"""The laser's mount: motions of the robot as motions of its laser, and back."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.motion import Odometry


def seen_from(T_a_b: Pose, motion: Odometry) -> Odometry:
    """The motion of frame a, where b is fixed to a at `T_a_b` and `motion` is that of b: `T_a_b @ motion @ T_b_a`.

    The covariance is of the error of (x, y, theta), in the axes of the frame before the motion.
    """
    if T_a_b == Pose():
        return motion
    T_b_a = T_a_b.inverse()
    jacobian = np.eye(3)
    jacobian[:2, :2] = rotation(T_a_b.theta)
    lever = rotation(T_a_b.theta + motion.motion.theta) @ T_b_a.position
    jacobian[:2, 2] = (-lever[1], lever[0])
    return Odometry(T_a_b @ motion.motion @ T_b_a, jacobian @ motion.cov @ jacobian.T)


def laser_poses(trajectory: Array, T_robot_laser: Pose) -> Array:
    """(K, 3) `T_world_laser` of the robot's poses (K, 3)."""
    from sixthsense.slam.scans.poses import compose

    return compose(trajectory, T_robot_laser.array())
