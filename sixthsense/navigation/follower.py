"""The follower: orient, then translate (report section 4.4)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import FollowConfig, RobotConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.pose_kernels import Triple, hypot, wrapped
from sixthsense.core.source import Command

_REORIENT = 5.0  # the robot stops and turns on the spot at this multiple of the heading slack


class FollowLimits(NamedTuple):
    """How precisely a path is followed, and how fast."""

    distance_slack_m: float
    heading_slack_rad: float
    speed: float
    """m/s"""
    turn_rate: float
    """rad/s"""
    period_s: float
    """of a control tick"""


class Following(NamedTuple):
    """A path, and how far the robot has come on it."""

    path: Array
    """(N, 2) way points, metres, world frame; the first one is where the robot was"""
    next: int
    """index of the way point ahead"""
    is_driving: bool
    """whether it drives towards it, else it turns towards it"""


@numba.njit(cache=True, error_model="numpy")
def followed(pose: Triple, following: Following, limits: FollowLimits) -> tuple[float, float, int, bool]:
    """Speed and turn rate of one control tick, then the next way point and whether the robot drives towards it.

    A standstill when no way point is left.
    """
    path, k, is_driving = following.path, following.next, following.is_driving
    x, y, distance = 0.0, 0.0, 0.0
    while k < len(path):
        x, y = path[k, 0] - pose[0], path[k, 1] - pose[1]
        distance = hypot(x, y)
        if distance > limits.distance_slack_m:
            break
        k += 1
        is_driving = False
    if k >= len(path):
        return 0.0, 0.0, k, is_driving
    error = wrapped(math.atan2(y, x) - pose[2])
    if is_driving and abs(error) > _REORIENT * limits.heading_slack_rad:
        is_driving = False
    if not is_driving:
        if abs(error) > limits.heading_slack_rad:
            return 0.0, _clip(error / limits.period_s, limits.turn_rate), k, is_driving
        is_driving = True
    # A small turn rate corrects drift while driving. One tick never overshoots the way point.
    turn_rate = _clip(2.0 * error * limits.speed / max(distance, 0.25), limits.turn_rate)
    return min(limits.speed, distance / limits.period_s), turn_rate, k, is_driving


@numba.njit(cache=True, error_model="numpy")
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


class Follower:
    """Drives along way points: to each by a turn on the spot and a straight line."""

    def __init__(self, config: FollowConfig, robot: RobotConfig) -> None:
        self.limits = FollowLimits(
            float(config.distance_slack_m),
            float(config.heading_slack_rad),
            float(robot.speed),
            float(robot.turn_rate),
            float(robot.control_period_s),
        )
        """how precisely and how fast it follows"""
        self.following = Following(np.zeros((0, 2)), 0, False)
        """the path and the progress on it"""

    def follow(self, path_world: Array) -> None:
        """Start a new path, (N, 2) metres, world frame; its first point is the robot's position."""
        self.following = Following(np.array(path_world, dtype=np.float64, order="C"), 1, False)

    def remaining(self, pose: Pose) -> Array:
        """(M, 2): the robot's position and the way points ahead."""
        return np.vstack([pose.position, self.following.path[self.following.next :]])

    def step(self, pose: Pose) -> Command:
        """The command of one control tick; a standstill when no way point is left."""
        speed, turn_rate, k, is_driving = followed((pose.x, pose.y, pose.theta), self.following, self.limits)
        self.following = Following(self.following.path, k, is_driving)
        return Command(speed, turn_rate)
