"""The navigator: it lets a task choose goals, plans paths to them, and drives.

A task is a state machine: it is given the map, the pose and what has happened, and returns the goal. An exploration
also sets which clearance is the least. Nobody calls back.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Protocol

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.navigation.driver import PATIENT_TURNS, DriveEvent, Driver
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

Outcome = Literal["goal reached", "tour ended", "explored", "explored in part", "lost", "goal unreachable", "stuck"]
Event = Literal[DriveEvent, "looked", "stopped"]
"""of the drive; looked: the map has changed; stopped: the guard has stopped the robot on its way"""


class Goal(NamedTuple):
    """Where to drive, and what to do there. A task returns the same one until it wants another."""

    position: Array
    """(2,) world frame, metres"""
    turn_rad: float
    """to be turned on the spot there"""


class Task(Protocol):
    """Decides where to drive."""

    outcome: Outcome | None
    """why it is over, None while it is not"""
    left: list[UnseenPlace]
    """the places that a completed exploration has not seen"""
    tours: list[Array]
    """way points (N, 2) of each tour by which an exploration chose a view: robot, views, home; world frame"""

    def next(self, map_: DrivingMap, pose: Pose, event: Event) -> Goal | None:
        """The goal after an event; None when the task is over."""
        ...


class Navigator:
    """Turns the map and the estimate into commands; without a task it steers nothing: a recorded robot moves as it did.

    Before the first map the robot stands still.
    """

    def __init__(
        self,
        task: Task | None = None,
        paths: PathPlanner | None = None,
        map_: DrivingMap | None = None,
        config: Config | None = None,
        timeout_outcome: str = "log ended",
    ) -> None:
        """Drive for a task over a map, by planned paths."""
        self.timeout_outcome = timeout_outcome
        """the outcome if time is up before the task is over"""
        self.plans: list[Array] = [] if paths is None else paths.plans
        """every planned path, (N, 2) each, world frame; always the same list"""
        self.tours: list[Array] = [] if task is None else task.tours
        """way points (N, 2) of each tour of an exploration: robot, views, home; always the same list"""
        config = config or Config()
        self.driver = Driver(config)
        """drives to the present goal"""
        self._task, self._paths, self._map = task, paths, map_
        self._goal: Goal | None = None
        self._patience_rad = math.tau * (PATIENT_TURNS if config.people else 1)

    @property
    def outcome(self) -> Outcome | None:
        """Why the task is over, None while it is not."""
        return None if self._task is None else self._task.outcome

    @property
    def plans_below_margin(self) -> int | None:
        """How many paths have less clearance than is wished for; None if the navigator plans nothing."""
        return None if self._paths is None else self._paths.plans_below_margin

    @property
    def plans_by_astar(self) -> int | None:
        """How many paths are A*'s because the planner found none; None if it is A*, or if nothing is planned."""
        return None if self._paths is None else self._paths.plans_by_astar

    @property
    def left(self) -> list[UnseenPlace]:
        """The places that a completed exploration has not seen."""
        return [] if self._task is None else self._task.left

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Update the map and the estimate of the robot's pose; plan again if the path is blocked now."""
        if self._map is not None:
            self._map.update(grid, estimate)
            self._react("looked", estimate.pose)

    def guard_stopped(self, pose: Pose) -> None:
        """Turn on the spot until another path is found: the guard has stopped the last command."""
        if self._goal is not None:
            self.driver.search(pose, self._patience_rad)
            self._react("stopped", pose)

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command for the next control tick."""
        command, event = self.driver.step(pose, stamp_ns)
        if event is not None:
            self._react(event, pose)
        return command

    def _react(self, event: Event, pose: Pose) -> None:
        """Let the task choose the goal, and plan where it is another one, or where the path is blocked."""
        assert self._task is not None and self._map is not None and self._paths is not None
        goal = self._task.next(self._map, pose, event)
        driver = self.driver
        if goal is None:
            driver.stop()
            return
        is_other, self._goal = goal is not self._goal, goal
        if is_other:
            driver.head_for(goal.position, goal.turn_rad)
        elif event != "looked" or driver.is_there or (driver.following and self._map.is_clear(driver.remaining(pose))):
            return
        path = self._paths.plan(self._map, pose, goal.position)
        if path is None:
            driver.search(pose, self._patience_rad)
        else:
            driver.follow(path)
