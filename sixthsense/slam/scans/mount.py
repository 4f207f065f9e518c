"""The laser's mount: motions of the robot as motions of its laser, and back."""

from __future__ import annotations

import math

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import compose, transformed_covariance

_ORIGIN = Pose()


def seen_from(T_a_b: Pose, motion: Odometry) -> Odometry:
    """The motion of frame a, where b is fixed to a at `T_a_b` and `motion` is that of b: `T_a_b @ motion @ T_b_a`.

    The covariance is of the error of (x, y, theta), in the axes of the frame before the motion.
    """
    if T_a_b == _ORIGIN:
        return motion
    T_b_a, heading = T_a_b.inverse(), T_a_b.theta + motion.motion.theta
    c, s = math.cos(heading), math.sin(heading)
    # What the motion's turn moves: a, as seen from b, in the axes before the motion.
    lever_x, lever_y = c * T_b_a.x - s * T_b_a.y, s * T_b_a.x + c * T_b_a.y
    cov = transformed_covariance(motion.cov, math.cos(T_a_b.theta), math.sin(T_a_b.theta), -lever_y, lever_x)
    return Odometry(T_a_b @ motion.motion @ T_b_a, cov)


class Mount:
    """Changes between the robot's poses and those of its laser."""

    def __init__(self, T_robot_laser: Pose) -> None:
        self.T_robot_laser, self.T_laser_robot = T_robot_laser, T_robot_laser.inverse()
        self._robot_laser, self._laser_robot = self.T_robot_laser.array(), self.T_laser_robot.array()

    def laser_motion(self, motion: Pose) -> Pose:
        """The laser's motion of the robot's."""
        return self.T_laser_robot @ motion @ self.T_robot_laser

    def laser_motions(self, motions: Array) -> Array:
        """(m, 3) motions of the laser of the robot's (m, 3)."""
        return compose(compose(self._laser_robot, motions), self._robot_laser)

    def robot_motions(self, motions: Array) -> Array:
        """(m, 3) motions of the robot of the laser's (m, 3)."""
        return compose(compose(self._robot_laser, motions), self._laser_robot)

    def robot_pose(self, T_world_laser: Array) -> Pose:
        """`T_world_robot` of `T_world_laser` (3,)."""
        return Pose.from_array(T_world_laser) @ self.T_laser_robot

    def laser_odometry(self, odometry: Odometry) -> Odometry:
        """The laser's odometry of the robot's."""
        return seen_from(self.T_laser_robot, odometry)

    def robot_odometry(self, odometry: Odometry) -> Odometry:
        """The robot's odometry of the laser's."""
        return seen_from(self.T_robot_laser, odometry)

    def laser_poses(self, trajectory: Array) -> Array:
        """(K, 3) `T_world_laser` of the robot's poses (K, 3)."""
        return compose(trajectory, self._robot_laser)
