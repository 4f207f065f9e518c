"""Driving to a list of goals."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.navigator import Navigator, Outcome
from sixthsense.navigation.path_driver import DriveEvent, PathDriver
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner, margin_m
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid


def goal_navigator(goals: Array, planner: Planner, config: Config) -> Navigator:
    """The navigator to `goals` (N, 2), world frame, in turn.

    It drives to them once, or again and again until the time is up on a tour that has a limit.
    """
    paths, is_tour = PathPlanner(planner, config), config.task == "tour"
    ways = itertools.cycle(goals) if is_tour and config.max_time is not None else iter(goals)
    at_end: Outcome = "tour ended" if is_tour else "goal reached"

    def begin(grid: Grid, estimate: Estimate) -> GoalDrive:
        map_ = _driving_map(grid, estimate, config)
        return GoalDrive(ways, at_end, PathDriver(map_, estimate.pose, next(ways), paths, config), config)

    return Navigator(begin, paths, "tour ended" if is_tour else "out of time")


class GoalDrive:
    """A drive that has a map: which goal comes next, and when it is over."""

    def __init__(self, goals: Iterator[Array], at_end: Outcome, driver: PathDriver, config: Config) -> None:
        """Drive on to `goals`, (2,) each; the outcome at the last one is `at_end`."""
        self.outcome: Outcome | None = None
        self.left: list[UnseenPlace] = []
        self.driver = driver
        self._goals, self._at_end, self._config = goals, at_end, config

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Plan again if the path crosses an obstacle now, or if there is no path."""
        self.driver.update_map(_driving_map(grid, estimate, self._config), estimate.pose)
        if not self.driver.path_is_free(estimate.pose):
            self.driver.plan(estimate.pose)

    def guard_stopped(self, pose: Pose) -> None:
        """Turn on the spot until another path is found."""
        self.driver.guard_stopped(pose)

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """At a goal take the next one; without a path or without progress the drive is over."""
        if event == "arrived":
            goal = next(self._goals, None)
            if goal is None:
                self.outcome = self._at_end
            else:
                self.driver.head_for(goal, pose)
        else:
            self.outcome = "goal unreachable" if event == "turned around" else "stuck"
        return self.outcome is not None


def _driving_map(grid: Grid, estimate: Estimate, config: Config) -> DrivingMap:
    def free_space(margin_m: float, places: Array, within: Ellipse | None) -> FreeSpace:
        return grid.free_space(margin_m=margin_m, within=within).covering(*places)

    return DrivingMap(grid, free_space, margin_m(estimate.pose_cov, config))
