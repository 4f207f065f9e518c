"""Driving to a list of goals."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.navigation.follower import Follower
from sixthsense.navigation.navigator import Outcome
from sixthsense.navigation.path_driver import DriveEvent, PathDriver
from sixthsense.navigation.path_margin import margin_m
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid


class GoalNavigator:
    """Drives to goals in turn: once, or again and again until the time is up on a tour that has a limit."""

    def __init__(self, goals: Array, planner: Planner, follower: Follower, config: Config) -> None:
        """Head for `goals` (N, 2), world frame, in turn."""
        is_tour = config.task == "tour"
        self.timeout_outcome = "tour ended" if is_tour else "out of time"
        self.left: list[UnseenPlace] = []
        self.tours: list[Array] = []
        self._paths = PathPlanner(planner, config)
        self._last_outcome: Outcome = "tour ended" if is_tour else "goal reached"
        repeats = is_tour and config.max_time is not None
        self._goals: Iterator[Array] = itertools.cycle(goals) if repeats else iter(goals)
        self._first_goal = next(self._goals)
        self._follower = follower
        self._config = config
        self._drive: _GoalDrive | None = None

    @property
    def outcome(self) -> Outcome | None:
        """Why the task is over, None while it is not."""
        return None if self._drive is None else self._drive.outcome

    @property
    def plans(self) -> list[Array]:
        """Every planned path."""
        return self._paths.plans

    @property
    def plans_below_margin(self) -> int:
        """How many of them keep less than the wanted margin."""
        return self._paths.plans_below_margin

    @property
    def plans_by_astar(self) -> int | None:
        """How many of them are A*'s because the planner found none; None if it is A*."""
        return self._paths.plans_by_astar

    @property
    def driver(self) -> PathDriver | None:
        """Drives to the present goal; None before the first map."""
        return None if self._drive is None else self._drive.driver

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Plan again if the path crosses an obstacle now, or if there is no path."""

        def free_space(margin_m: float, places: Array, within: Ellipse | None) -> FreeSpace:
            return grid.free_space(*places, margin_m=margin_m, within=within)

        pose = estimate.pose
        map_ = DrivingMap(grid, free_space, margin_m(estimate.pose_cov, self._config))
        if self._drive is None:
            driver = PathDriver(map_, pose, self._first_goal, self._paths, self._follower, self._config)
            self._drive = _GoalDrive(self._goals, self._last_outcome, driver)
        else:
            self._drive.driver.update_map(map_, pose)
        if not self._drive.driver.path_is_free(pose):
            self._drive.driver.plan(pose)

    def guard_stopped(self, pose: Pose) -> None:
        """Turn on the spot until another path is found."""
        if self._drive is not None:
            self._drive.driver.guard_stopped(pose)

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command of a control tick; a standstill before the first map."""
        return Command() if self._drive is None else self._drive.driver.step(pose, stamp_ns, self._drive)


class _GoalDrive:
    """A drive that has a map: which goal comes next, and when it is over."""

    def __init__(self, goals: Iterator[Array], last_outcome: Outcome, driver: PathDriver) -> None:
        """Drive to `goals`; the outcome at the last one is `last_outcome`."""
        self.outcome: Outcome | None = None
        self._last_outcome = last_outcome
        self.driver = driver
        self._goals = goals

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """At a goal take the next one; without a path or without progress the drive is over."""
        if event == "arrived":
            goal = next(self._goals, None)
            if goal is None:
                self.outcome = self._last_outcome
            else:
                self.driver.head_for(goal, pose)
        else:
            self.outcome = "goal unreachable" if event == "turned around" else "stuck"
        return self.outcome is not None
