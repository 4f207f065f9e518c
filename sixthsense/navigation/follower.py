"""The follower: orient, then translate (report section 4.4)."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.config import FollowConfig, RobotConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.source import Command

_REORIENT = 5.0  # the robot stops and turns on the spot at this multiple of the heading slack


class Follower:
    """Drives along way points: to each by a turn on the spot and a straight line."""

    def __init__(self, config: FollowConfig, robot: RobotConfig) -> None:
        self._config = config
        self._robot = robot
        self._path = np.zeros((0, 2))
        self._next = 0
        self._driving = False

    def follow(self, path_world: Array) -> None:
        """Start a new path, (N, 2) metres, world frame; its first point is the robot's position."""
        self._path = np.array(path_world, dtype=np.float64)
        self._next = 1
        self._driving = False

    def remaining(self, pose: Pose) -> Array:
        """(M, 2): the robot's position and the way points ahead."""
        return np.vstack([pose.position, self._path[self._next :]])

    def step(self, pose: Pose) -> Command:
        """The command of one control tick; a standstill when no way point is left."""
        config, robot = self._config, self._robot
        while self._next < len(self._path):
            ahead = self._path[self._next] - pose.position
            distance = math.hypot(ahead[0], ahead[1])
            if distance > config.distance_slack_m:
                break
            self._next += 1
            self._driving = False
        else:
            return Command()
        dt = robot.control_period_s
        error = wrap_angle(math.atan2(ahead[1], ahead[0]) - pose.theta)
        if self._driving and abs(error) > _REORIENT * config.heading_slack_rad:
            self._driving = False
        if not self._driving:
            if abs(error) > config.heading_slack_rad:
                return Command(0.0, _clip(error / dt, robot.turn_rate))
            self._driving = True
        # A small turn rate corrects drift while driving. One tick never overshoots the way point.
        steer = _clip(2.0 * error * robot.speed / max(distance, 0.25), robot.turn_rate)
        return Command(min(robot.speed, distance / dt), steer)


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
