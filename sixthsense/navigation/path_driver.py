"""Driving to one place: plan, follow, plan again when the path is blocked, and turn around while there is no path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from sixthsense.config import Config, RobotConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.source import Command
from sixthsense.navigation.follower import Follower
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


class ProgressMonitor:
    """Watches whether the robot moves on."""

    def __init__(self, robot: RobotConfig) -> None:
        """Allow a slow robot the time for two turns on the spot and for the distance."""
        patience_s = max(_STUCK_S, 4.0 * math.pi / robot.turn_rate + 2.0 * _STUCK_M / robot.speed)
        self._patience_ns = 1e9 * patience_s
        self._anchor: tuple[int, Pose] | None = None

    def reset(self) -> None:
        """Start to watch anew."""
        self._anchor = None

    def is_stuck(self, pose: Pose, stamp_ns: int) -> bool:
        """Whether the robot has not moved on for too long; if so, start anew."""
        if self._anchor is None or math.dist(pose.position, self._anchor[1].position) > _STUCK_M:
            self._anchor = (stamp_ns, pose)
        elif stamp_ns - self._anchor[0] > self._patience_ns:
            self._anchor = None
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
