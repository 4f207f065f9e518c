"""Where to go next, and how: goals, plans and replans, and the outcome of it all (report sections 4.4 and 4.5)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.source import Command
from sixthsense.navigation.clearance import margin_m, plan_with_margin, way_out
from sixthsense.navigation.follow import Follower
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import path_is_free, shortcut
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import FreeSpace, Grid

Outcome = Literal["goal reached", "explored", "explored in part", "goal unreachable", "stuck"]
Reason = Literal["cut off by inflation only", "unreachable", "gave up"]

_STUCK_S = 60.0  # a robot that has not come this much nearer to anywhere is stuck
_STUCK_M = 0.1


@dataclass(frozen=True, slots=True)
class Place:
    """A place that an exploration has left unseen."""

    x: float
    """world frame, metres"""
    y: float
    """the same"""
    area_m2: float
    """of what was not seen there, as far as the map tells"""
    reason: Reason
    """cut off by inflation only: without the clearance the robot would fit through; unreachable: it would not; gave up:
    it was looked at and did not show"""


def as_reason(text: str) -> Reason:
    """The reason of that name; ValueError listing the known ones for any other."""
    reasons: tuple[Reason, ...] = get_args(Reason)
    for reason in reasons:
        if text == reason:
            return reason
    raise ValueError(f"reason: found {text!r}, allowed: {', '.join(reasons)}")


class Navigator(Protocol):
    """What the loop asks of whoever steers."""

    outcome: Outcome | None
    """why the task is over, None while it is not"""
    at_the_end: str
    """the outcome when time is up before that"""
    plans: list[Array]
    """every planned path, (N, 2) each, world frame"""
    plans_below_margin: int | None
    """how many of them keep less than the margin that was wanted; None of who plans nothing"""
    plans_by_astar: int | None
    """how many of them are A*'s because the planner found none; None of who plans nothing, or by A* alone"""
    left: list[Place]
    """what an exploration that is over has not seen"""

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed, and what is believed of the robot."""
        ...

    def blocked(self, pose: Pose) -> None:
        """Take in that the guard has stopped the last command."""
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
        self.plans_below_margin: int | None = None
        self.plans_by_astar: int | None = None
        self.left: list[Place] = []

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Nothing to do."""

    def blocked(self, pose: Pose) -> None:
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
        self.plans_below_margin: int | None = 0
        self.left: list[Place] = []
        self._goals: Iterator[Array] = itertools.cycle(goals) if rounds else iter(goals)
        self._goal = next(self._goals)
        # A* says whether there is a way and how far it can keep from obstacles; whoever else plans, plans there.
        self._scouts = AStar(), AStar()
        self._planner = None if type(planner) is AStar else planner
        self.plans_by_astar: int | None = None if self._planner is None else 0
        self._follower = follower
        self._config = config
        self._grid: Grid | None = None
        self._space: FreeSpace | None = None
        self._margin_m = 0.0  # wanted beyond the inflation
        self._planned = False
        self._turn_left = 0.0
        self._heading: float | None = None  # last seen while turning to look around
        # A slow robot may take long to turn around, or to get anywhere at all.
        robot = config.robot
        self._patience_ns = 1e9 * max(_STUCK_S, 4.0 * math.pi / robot.turn_rate + 2.0 * _STUCK_M / robot.speed)
        self._anchor: tuple[int, Pose] | None = None

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Replan if the path is crossed by an obstacle now, or if there is none."""
        pose = estimate.pose
        self._grid, self._margin_m = grid, margin_m(estimate.pose_cov, self._config)
        self._space = self._free_space(0.0, np.array([pose.position, self._goal]))
        if self._planned and path_is_free(self._space, self._follower.remaining(pose)):
            return
        self._plan(pose)

    def blocked(self, pose: Pose) -> None:
        """Turn on the spot, until a key scan has brought what is in the way into the map and a plan leads round it."""
        self._planned = False
        if self._heading is None:
            self._heading, self._turn_left = pose.theta, 2.0 * math.pi

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """Follow the path; at the goal take the next one; without a path turn once around and look again."""
        if math.dist(pose.position, self._goal) <= self._config.follow.goal_slack_m:
            self._arrived(pose)
            if self.outcome is not None:
                return Command()
        self._watch(pose, stamp_ns)
        if self._planned:
            return self._follower.step(pose)
        return self._look_around(pose)

    def _arrived(self, pose: Pose) -> None:
        """What to do at the goal: head for the next one, or be done."""
        following = next(self._goals, None)
        if following is None:
            self.outcome = "goal reached"
        else:
            self._head_for(following, pose)

    def _looked_around(self, pose: Pose) -> None:
        """What to do after a turn around that has shown no way."""
        self.outcome = "goal unreachable"

    def _got_stuck(self, pose: Pose) -> None:
        """What to do about a robot that gets nowhere."""
        self.outcome = "stuck"

    def _head_for(self, goal: Array, pose: Pose) -> None:
        self._goal = goal
        self._anchor = None
        if self._space is not None:
            self._space = self._space.covering(pose.position, self._goal)
            self._plan(pose)

    def _plan(self, pose: Pose) -> None:
        assert self._space is not None and self._grid is not None
        start, config = pose.position, self._config
        leaving = np.zeros((0, 2))
        if self._space.is_blocked(start):
            # Noise has put the robot inside the inflation: leave it by the shortest way, then plan.
            path = way_out(self._grid, self._space, start, config.grid.clearance_m)
            if path is not None:
                leaving, start = path[:-1], path[-1]
        # A goal that the inflation covers by a hair is reached as well from the nearest free place within the slack.
        slack = self._config.follow.goal_slack_m - self._config.follow.distance_slack_m
        goal = self._space.nearest_free(self._goal, slack)
        goal = self._goal if goal is None else goal

        plan, space, kept_m = plan_with_margin(
            self._scouts, self._free_space, start, goal, self._margin_m, config.safety.detour
        )
        self._planned = plan.found
        if not plan.found:
            if self._heading is None:
                self._heading, self._turn_left = pose.theta, 2.0 * math.pi
            return
        self._heading = None
        if self._planner is not None:
            own = self._planner.plan(space, start, goal)
            plan = own if own.found else plan
            self.plans_by_astar = (self.plans_by_astar or 0) + (not own.found)
        path = plan.path_world
        if config.follow.shortcut:
            path = shortcut(space, path)
        path = np.vstack([leaving, path])
        self.plans.append(np.vstack([leaving, plan.path_world]))
        self.plans_below_margin = (self.plans_below_margin or 0) + (kept_m < self._margin_m)
        self._follower.follow(path)

    def _free_space(self, margin_m: float, places: Array) -> FreeSpace:
        """Where the robot may drive, with a margin beyond the inflation that gives way about (K, 2) places."""
        assert self._grid is not None
        return self._grid.free_space(*places, margin_m=margin_m)

    def _look_around(self, pose: Pose) -> Command:
        """Turn once on the spot: what blocks the way may be one stray return, which more scans will clear."""
        if self._heading is None:
            return Command()  # no map yet
        self._turn_left -= abs(wrap_angle(pose.theta - self._heading))
        self._heading = pose.theta
        if self._turn_left <= 0.0:
            self._heading = None
            self._looked_around(pose)
            return Command()
        return Command(0.0, self._config.robot.turn_rate)

    def _watch(self, pose: Pose, stamp_ns: int) -> None:
        if self._anchor is None or math.dist(pose.position, self._anchor[1].position) > _STUCK_M:
            self._anchor = (stamp_ns, pose)
        elif stamp_ns - self._anchor[0] > self._patience_ns:
            self._anchor = None
            self._got_stuck(pose)
