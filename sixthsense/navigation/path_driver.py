"""Driving to one place: plan, follow, plan again when the path is blocked, and turn around while there is no path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numba
import numpy as np

from sixthsense.config import Config, RobotConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.pose_kernels import Triple, hypot, wrapped
from sixthsense.core.source import Command
from sixthsense.navigation.follower import Follower, Following, FollowLimits, followed
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.planners.shortcut import path_is_free

DriveEvent = Literal["arrived", "turned around", "stuck"]
"""arrived: at the goal, on every tick there; turned around: a turn on the spot is complete, where people are expected
several, and no path was found during it; stuck: no progress for a while."""

PATIENT_TURNS = 5
"""turns on the spot, half a minute, that a robot without a way waits for people to go"""
_STUCK_S = 60.0  # least time without progress after which the robot is stuck
_STUCK_M = 0.1  # progress


class Mission(Protocol):
    """Decides where to drive."""

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """React to an event, perhaps with another goal; whether the mission is over."""
        ...


class DriverLimits(NamedTuple):
    """When a drive to a goal needs more than a command, and how fast the robot turns on the spot."""

    goal_slack_m: float
    patience_ns: float
    """time without progress after which the robot is stuck"""
    turn_rate: float
    """rad/s"""
    follow: FollowLimits


class GoalDrive(NamedTuple):
    """A drive to a goal, as kernels change it tick by tick."""

    goal: tuple[float, float]
    is_following: bool
    """whether there is a path that is being followed"""
    following: Following
    is_turning: bool
    """whether the robot turns on the spot, as long as there is no path"""
    heading: float
    """at the last tick of that turn"""
    left_rad: float
    """still to be turned"""
    is_watched: bool
    """whether there is a place since which progress is watched"""
    anchor: tuple[int, float, float]
    """stamp (ns) and that place"""


@numba.njit(cache=True, error_model="numpy")
def steered(
    drive: GoalDrive, pose: Triple, stamp_ns: int, limits: DriverLimits
) -> tuple[GoalDrive, float, float, bool]:
    """The drive after a control tick, speed and turn rate, and whether that is all that the tick needs.

    It is not where the mission has to be asked: the robot is at the goal, is stuck or has completed a turn.
    """
    if hypot(pose[0] - drive.goal[0], pose[1] - drive.goal[1]) <= limits.goal_slack_m:
        return drive, 0.0, 0.0, False
    anchor, following, heading, left_rad = drive.anchor, drive.following, drive.heading, drive.left_rad
    if not drive.is_watched or hypot(pose[0] - anchor[1], pose[1] - anchor[2]) > _STUCK_M:
        anchor = (stamp_ns, pose[0], pose[1])
    elif stamp_ns - anchor[0] > limits.patience_ns:
        return drive, 0.0, 0.0, False
    speed, turn_rate = 0.0, 0.0
    if drive.is_following:
        speed, turn_rate, k, is_driving = followed(pose, following, limits.follow)
        following = Following(following.path, k, is_driving)
    elif drive.is_turning:
        left_rad -= abs(wrapped(pose[2] - heading))
        if left_rad <= 0.0:
            return drive, 0.0, 0.0, False
        heading, turn_rate = pose[2], limits.turn_rate
    after = GoalDrive(drive.goal, drive.is_following, following, drive.is_turning, heading, left_rad, True, anchor)
    return after, speed, turn_rate, True


class ProgressMonitor:
    """Watches whether the robot moves on."""

    def __init__(self, robot: RobotConfig) -> None:
        """Allow a slow robot the time for two turns on the spot and for the distance."""
        patience_s = max(_STUCK_S, 4.0 * math.pi / robot.turn_rate + 2.0 * _STUCK_M / robot.speed)
        self.patience_ns = 1e9 * patience_s
        """time without progress after which the robot is stuck"""
        self.anchor: tuple[int, float, float] | None = None
        """stamp (ns) and place since which the robot is watched"""

    def reset(self) -> None:
        """Start to watch anew."""
        self.anchor = None

    def is_stuck(self, pose: Pose, stamp_ns: int) -> bool:
        """Whether the robot has not moved on for too long; if so, start anew."""
        if self.anchor is None or math.dist((pose.x, pose.y), self.anchor[1:]) > _STUCK_M:
            self.anchor = (stamp_ns, pose.x, pose.y)
        elif stamp_ns - self.anchor[0] > self.patience_ns:
            self.anchor = None
            return True
        return False


@dataclass(slots=True)
class _Turn:
    """A turn on the spot."""

    heading: float
    """at the last tick"""
    left_rad: float
    """still to be turned"""

    def advance(self, heading: float) -> bool:
        """Take in the heading; whether the turn is complete."""
        self.left_rad -= abs(wrap_angle(heading - self.heading))
        self.heading = heading
        return self.left_rad <= 0.0


class PathDriver:
    """Drives the robot to a goal: along a path, or turning on the spot while there is none.

    A blocked path may be due to a single wrong return, which more scans will clear: hence the turn.
    """

    def __init__(
        self, map_: DrivingMap, pose: Pose, goal: Array, planner: PathPlanner, follower: Follower, config: Config
    ) -> None:
        """Stand at `pose` with the goal (2,), without a path yet."""
        self.goal = goal
        self.following = False
        """whether there is a path that is being followed"""
        self._planner = planner
        self._follower = follower
        self._config = config
        self._patience_rad = 2.0 * math.pi * (PATIENT_TURNS if config.people else 1)
        self._progress = ProgressMonitor(config.robot)
        self._turn: _Turn | None = None
        self.limits = DriverLimits(
            float(config.follow.goal_slack_m),
            float(self._progress.patience_ns),
            float(config.robot.turn_rate),
            follower.limits,
        )
        """when a tick needs more than a command"""
        self.update_map(map_, pose)

    def update_map(self, map_: DrivingMap, pose: Pose) -> None:
        """Take in another map."""
        self._map = map_
        self.space = map_.free_space(0.0, np.array([pose.position, self.goal]), None)
        """where the robot may drive, without a margin"""

    def head_for(self, goal: Array, pose: Pose) -> None:
        """Plan a path to another goal (2,) and follow it."""
        self.goal = goal
        self._progress.reset()
        self.space = self.space.covering(pose.position, goal)
        self.plan(pose)

    def plan(self, pose: Pose) -> None:
        """Plan a path to the goal and follow it; without a path, turn around."""
        path = self._planner.plan(self._map, self.space, pose.position, self.goal)
        self.following = path is not None
        if path is not None:
            self._turn = None
            self._follower.follow(path)
        elif self._turn is None:
            self._turn = _Turn(pose.theta, self._patience_rad)

    def path_is_free(self, pose: Pose) -> bool:
        """Whether there is a path and the rest of it is free."""
        return self.following and path_is_free(self.space, self._follower.remaining(pose))

    def remaining_m(self, pose: Pose) -> float:
        """Length of the rest of the path; infinite without one."""
        if not self.following:
            return math.inf
        steps = np.diff(self._follower.remaining(pose), axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def stop(self) -> None:
        """Drop the path, and end a turn."""
        self.following, self._turn = False, None

    def turn_around(self, pose: Pose, angle_rad: float) -> None:
        """Drop the path and turn on the spot."""
        self.following, self._turn = False, _Turn(pose.theta, angle_rad)

    def wait(self, pose: Pose) -> None:
        """Drop the path and turn around once: who is in the way may go."""
        self._progress.reset()
        self.turn_around(pose, 2.0 * math.pi)

    def guard_stopped(self, pose: Pose) -> None:
        """Drop the path and turn, until a keyframe has brought the obstacle into the map and a new path avoids it."""
        self.following = False
        if self._turn is None:
            self._turn = _Turn(pose.theta, self._patience_rad)

    @property
    def drive(self) -> GoalDrive:
        """The state that control ticks change."""
        turn, anchor = self._turn or _Turn(0.0, 0.0), self._progress.anchor
        return GoalDrive(
            (float(self.goal[0]), float(self.goal[1])),
            self.following,
            self._follower.following,
            self._turn is not None,
            turn.heading,
            turn.left_rad,
            anchor is not None,
            anchor or (0, 0.0, 0.0),
        )

    def passed(self, drive: GoalDrive) -> None:
        """Take in control ticks in which a kernel has steered, to the state after them."""
        self._follower.following = drive.following
        self._turn = _Turn(drive.heading, drive.left_rad) if drive.is_turning else None
        self._progress.anchor = drive.anchor if drive.is_watched else None

    def step(self, pose: Pose, stamp_ns: int, mission: Mission) -> Command:
        """The command of a control tick, after `mission` has handled the events."""
        if math.dist(pose.position, self.goal) <= self._config.follow.goal_slack_m and mission.handle("arrived", pose):
            return Command()
        if self._progress.is_stuck(pose, stamp_ns):
            mission.handle("stuck", pose)
        if self.following:
            return self._follower.step(pose)
        if self._turn is None:
            return Command()
        if self._turn.advance(pose.theta):
            self._turn = None
            mission.handle("turned around", pose)
            return Command()
        return Command(0.0, self._config.robot.turn_rate)
