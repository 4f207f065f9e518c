"""Driving to one place: along a path, or turning on the spot while there is none.

A path is followed by turns on the spot and straight lines: orient, then translate (report section 4.4). A blocked path
may be due to a single wrong return, which more scans will clear: hence the turn while there is no path.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import Triple, wrapped
from sixthsense.core.source import Command

DriveEvent = Literal["arrived", "no way", "stuck"]
"""arrived: at the goal, and turned there as far as was asked; no way: turned on the spot, and no path was found during
it; stuck: no progress for a while."""

PATIENT_TURNS = 5
"""turns on the spot, half a minute, that a robot without a way waits for people to go"""
_PROGRESS_M = 2.0 * GOAL_SLACK_M  # of a robot that is not stuck
_REORIENT = 5.0  # the robot stops and turns on the spot at this multiple of the heading slack
_NO_PATH = np.zeros((0, 2))


class DriverLimits(NamedTuple):
    """How precisely a path is followed, how fast, and for how long without progress."""

    distance_slack_m: float
    heading_slack_rad: float
    speed: float
    """m/s"""
    turn_rate: float
    """rad/s"""
    period_s: float
    """of a control tick"""
    patience_ns: float
    """time without progress after which the robot is stuck"""

    @staticmethod
    def of(config: Config) -> DriverLimits:
        """The limits of a configuration. A robot is stuck after twice the time of its patient turns and of progress."""
        follow, robot = config.follow, config.robot
        patience_s = 2.0 * (PATIENT_TURNS * math.tau / robot.turn_rate + _PROGRESS_M / robot.speed)
        slacks = follow.distance_slack_m, follow.heading_slack_rad
        limits = *slacks, robot.speed, robot.turn_rate, robot.control_period_s, patience_s * 10**9
        return DriverLimits(*map(float, limits))


class Drive(NamedTuple):
    """A drive to a goal, as it changes tick by tick."""

    goal: tuple[float, float]
    path: Array
    """(N, 2) way points, metres, world frame; empty without a path"""
    next: int
    """index of the way point ahead"""
    is_driving: bool
    """whether the robot drives towards it, else it turns towards it"""
    is_there: bool
    """whether it has come to the goal, and turns there"""
    left_rad: float
    """still to be turned on the spot, without a path"""
    heading: float
    """at the last tick of that turn"""
    anchor: tuple[int, float, float]
    """stamp (ns) and place since which progress is watched; -1: not yet"""

    @classmethod
    def begin(cls, goal: Array, is_there: bool) -> Drive:
        """A drive to a goal (2,), without a path yet."""
        x, y = goal.tolist()
        return cls((x, y), _NO_PATH, 0, False, is_there, 0.0, 0.0, (-1, 0.0, 0.0))


_STEERED, _ARRIVED, _NO_WAY, _STUCK = range(4)
_EVENTS: tuple[DriveEvent | None, ...] = (None, "arrived", "no way", "stuck")


@numba.njit(cache=True, error_model="numpy")
def followed(
    path: Array, k: int, is_driving: bool, pose: Triple, limits: DriverLimits
) -> tuple[float, float, int, bool]:
    """Speed and turn rate of one control tick, then the next way point and whether the robot drives towards it.

    `k` and `is_driving` are those of the tick before. When no way point is left, the robot stands still.
    """
    x, y, distance = 0.0, 0.0, 0.0
    while k < len(path):
        x, y = path[k, 0] - pose[0], path[k, 1] - pose[1]
        distance = math.hypot(x, y)
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
    # A small turn rate corrects drift while driving: that of the arc through the way point, as if it were 0.25 m away
    # at least. One tick never overshoots the way point.
    turn_rate = _clip(2.0 * error * limits.speed / max(distance, 0.25), limits.turn_rate)
    return min(limits.speed, distance / limits.period_s), turn_rate, k, is_driving


@numba.njit(cache=True, error_model="numpy")
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@numba.njit(cache=True, error_model="numpy")
def advanced(
    drive: Drive, pose: Triple, stamp_ns: int, turn_rad: float, limits: DriverLimits
) -> tuple[Drive, float, float, int]:
    """The drive after a control tick, speed, turn rate, and the event; `turn_rad` is to be turned at the goal."""
    goal, path, k, is_driving, is_there, left_rad, heading, anchor = drive
    speed, turn_rate, event = 0.0, 0.0, _STEERED
    if not is_there and math.hypot(pose[0] - goal[0], pose[1] - goal[1]) <= GOAL_SLACK_M:
        is_there, path, left_rad, heading = True, path[:0], turn_rad, pose[2]
    if anchor[0] < 0 or math.hypot(pose[0] - anchor[1], pose[1] - anchor[2]) > _PROGRESS_M:
        anchor = (stamp_ns, pose[0], pose[1])
    if len(path):
        speed, turn_rate, k, is_driving = followed(path, k, is_driving, pose, limits)
    else:
        left_rad -= abs(wrapped(pose[2] - heading))
        heading = pose[2]
        if left_rad > 0.0:
            turn_rate = limits.turn_rate
        else:
            event = _ARRIVED if is_there else _NO_WAY
    if event == _STEERED and stamp_ns - anchor[0] > limits.patience_ns:
        anchor, event = (-1, 0.0, 0.0), _STUCK
    return Drive(goal, path, k, is_driving, is_there, left_rad, heading, anchor), speed, turn_rate, event


class Driver:
    """Follows a path to a goal, and reports events; it decides nothing."""

    def __init__(self, config: Config) -> None:
        """Stand still."""
        self.drive = Drive.begin(np.zeros(2), is_there=True)
        """the state that control ticks change"""
        self._limits = DriverLimits.of(config)
        self._turn_rad, self._is_idle = 0.0, True

    @property
    def following(self) -> bool:
        """Whether there is a path that is being followed."""
        return len(self.drive.path) > 0

    @property
    def is_there(self) -> bool:
        """Whether the robot has come to the goal; it may still turn there."""
        return self.drive.is_there

    def remaining(self, pose: Pose) -> Array:
        """(M, 2): the robot's position and the way points ahead."""
        return np.vstack([pose.position, self.drive.path[self.drive.next :]])

    def head_for(self, goal: Array, turn_rad: float) -> None:
        """Drive to a goal (2,), without a path yet, and turn there on the spot."""
        self.drive = Drive.begin(goal, is_there=False)
        self._turn_rad, self._is_idle = turn_rad, False

    def follow(self, path: Array) -> None:
        """Follow a path (N, 2) to the goal; the first way point is where the robot is."""
        self.drive = self.drive._replace(path=np.array(path, dtype=np.float64, order="C"), next=1, is_driving=False)

    def search(self, pose: Pose, angle_rad: float) -> None:
        """Drop the path, and turn on the spot until there is another one; a turn that has begun goes on."""
        if self.following or self.drive.left_rad <= 0.0:
            self.drive = self.drive._replace(path=_NO_PATH, left_rad=angle_rad, heading=pose.theta)

    def stop(self) -> None:
        """Stand still until there is another goal."""
        self._is_idle = True

    def step(self, pose: Pose, stamp_ns: int) -> tuple[Command, DriveEvent | None]:
        """The command of a control tick, and what has happened."""
        if self._is_idle:
            return Command(), None
        now = self.drive, pose.triple(), stamp_ns
        self.drive, speed, turn_rate, event = advanced(*now, self._turn_rad, self._limits)
        return Command(speed, turn_rate), _EVENTS[event]
