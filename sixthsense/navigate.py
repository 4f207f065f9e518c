"""Where to go next, and how: goals, plans and replans, and the outcome of it all (report sections 4.4 and 4.5)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Literal, Protocol

import numpy as np

from sixthsense.config import Config
from sixthsense.follow import Follower
from sixthsense.geometry import Array, Pose, wrap_angle
from sixthsense.grid import FreeSpace, Grid
from sixthsense.planners import Planner
from sixthsense.planners.shortcut import path_is_free, shortcut
from sixthsense.source import Command

Outcome = Literal["goal reached", "goal unreachable", "stuck"]

_ESCAPE_M = 0.5  # how far a robot that finds itself inside the inflation looks for a way out
_STUCK_S = 60.0  # a robot that has not come this much nearer to anywhere is stuck
_STUCK_M = 0.1


class Navigator(Protocol):
    """What the loop asks of whoever steers."""

    outcome: Outcome | None
    """why the task is over, None while it is not"""
    at_the_end: str
    """the outcome when time is up before that"""
    plans: list[Array]
    """every planned path, (N, 2) each, world frame"""

    def look(self, grid: Grid, pose: Pose) -> None:
        """Take in a map that has changed."""
        ...

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command for the next control tick."""
        ...


class Passenger:
    """Steers nothing: a recorded robot goes where it went."""

    def __init__(self) -> None:
        self.outcome: Outcome | None = None
        self.at_the_end = "log ended"
        self.plans: list[Array] = []

    def look(self, grid: Grid, pose: Pose) -> None:
        """Nothing to do."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """A standstill, which a log ignores."""
        return Command()


class Driver:
    """Drives to a list of goals, once or in rounds, and replans when a newly seen obstacle crosses the path."""

    def __init__(self, goals: Array, rounds: bool, planner: Planner, follower: Follower, config: Config) -> None:
        """Head for `goals` (N, 2), world frame, in turn; `rounds` starts over after the last."""
        self.outcome: Outcome | None = None
        self.at_the_end = "tour ended" if rounds else "out of time"
        self.plans: list[Array] = []
        self._goals: Iterator[Array] = itertools.cycle(goals) if rounds else iter(goals)
        self._goal = next(self._goals)
        self._planner = planner
        self._follower = follower
        self._config = config
        self._space: FreeSpace | None = None
        self._planned = False
        self._turn_left = 0.0
        self._heading: float | None = None  # last seen while turning to look around
        # A slow robot may take long to turn around, or to get anywhere at all.
        robot = config.robot
        self._patience_ns = 1e9 * max(_STUCK_S, 4.0 * math.pi / robot.turn_rate + 2.0 * _STUCK_M / robot.speed)
        self._anchor: tuple[int, Pose] | None = None

    def look(self, grid: Grid, pose: Pose) -> None:
        """Replan if the path is crossed by an obstacle now, or if there is none."""
        self._space = grid.free_space(pose.position, self._goal)
        if self._planned and path_is_free(self._space, self._follower.remaining(pose)):
            return
        self._plan(pose)

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """Follow the path; at the goal take the next one; without a path turn once around and look again."""
        if math.dist(pose.position, self._goal) <= self._config.follow.goal_slack_m:
            following = next(self._goals, None)
            if following is None:
                self.outcome = "goal reached"
                return Command()
            self._goal = following
            self._anchor = None
            if self._space is not None:
                self._space = self._space.covering(pose.position, self._goal)
                self._plan(pose)
        self._watch(pose, stamp_ns)
        if self._planned:
            return self._follower.step(pose)
        return self._look_around(pose)

    def _plan(self, pose: Pose) -> None:
        assert self._space is not None
        start = pose.position
        way_out = np.zeros((0, 2))
        if self._space.is_blocked(start):
            # Noise has put the robot inside the inflation: leave it by the shortest way, then plan.
            free = self._space.nearest_free(start, _ESCAPE_M)
            if free is not None:
                way_out, start = start[None], free
        # A goal that the inflation covers by a hair is reached as well from the nearest free place within the slack.
        slack = self._config.follow.goal_slack_m - self._config.follow.distance_slack_m
        goal = self._space.nearest_free(self._goal, slack)
        plan = self._planner.plan(self._space, start, self._goal if goal is None else goal)
        self._planned = plan.found
        if not plan.found:
            if self._heading is None:
                self._heading, self._turn_left = pose.theta, 2.0 * math.pi
            return
        self._heading = None
        path = shortcut(self._space, plan.path_world) if self._config.follow.shortcut else plan.path_world
        path = np.vstack([way_out, path])
        self.plans.append(np.vstack([way_out, plan.path_world]))
        self._follower.follow(path)

    def _look_around(self, pose: Pose) -> Command:
        """Turn once on the spot: what blocks the way may be one stray return, which more scans will clear."""
        if self._heading is None:
            return Command()  # no map yet
        self._turn_left -= abs(wrap_angle(pose.theta - self._heading))
        self._heading = pose.theta
        if self._turn_left <= 0.0:
            self.outcome = "goal unreachable"
            return Command()
        return Command(0.0, self._config.robot.turn_rate)

    def _watch(self, pose: Pose, stamp_ns: int) -> None:
        if self._anchor is None or math.dist(pose.position, self._anchor[1].position) > _STUCK_M:
            self._anchor = (stamp_ns, pose)
        elif stamp_ns - self._anchor[0] > self._patience_ns:
            self.outcome = "stuck"
