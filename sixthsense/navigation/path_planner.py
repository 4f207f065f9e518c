"""Planning one path for the robot: out of the inflation, with a margin, by the configured planner, with shortcuts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.path_margin import FreeSpaceFunction, plan_with_margin
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import shortcut
from sixthsense.navigation.ways import way_out
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid


@dataclass(frozen=True, slots=True, eq=False)
class DrivingMap:
    """The map as a path planner sees it."""

    grid: Grid
    free_space: FreeSpaceFunction
    """where the robot may drive"""
    margin_m: float
    """that paths should keep beyond the inflation"""


class PathPlanner:
    """Plans paths and counts them."""

    def __init__(self, planner: Planner, config: Config) -> None:
        """Plan by `planner`.

        A* proves reachability and finds the margin; the configured planner then searches the same space.
        """
        self.plans: list[Array] = []
        """every planned path, (N, 2) each, world frame"""
        self.plans_below_margin = 0
        """how many of them keep less than the wanted margin"""
        self.plans_by_astar: int | None = None if type(planner) is AStar else 0
        """how many of them are A*'s because the configured planner found none; None if that is A*"""
        self._astar = AStar(), AStar()
        self._planner = None if type(planner) is AStar else planner
        self._config = config

    def plan(self, map_: DrivingMap, space: FreeSpace, start: Array, goal: Array) -> Array | None:
        """The way points (N, 2) from `start` to `goal`, (2,) each; None if there is no path.

        `space` is the free space without a margin. A start inside the inflation is left by the shortest path.
        """
        config = self._config
        leaving = np.zeros((0, 2))
        if space.is_blocked(start):
            path = way_out(map_.grid, space, start, config.grid.clearance_m)
            if path is not None:
                leaving, start = path[:-1], path[-1]
        # A goal just inside the inflation is reached from the nearest free place within the slack.
        free_goal = space.nearest_free(goal, config.follow.goal_slack_m - config.follow.distance_slack_m)
        goal = goal if free_goal is None else free_goal
        plan, space, kept_m = plan_with_margin(
            self._astar, map_.free_space, start, goal, map_.margin_m, config.safety.detour
        )
        if not plan.found:
            return None
        if self._planner is not None:
            own = self._planner.plan(space, start, goal)
            plan = own if own.found else plan
            self.plans_by_astar = (self.plans_by_astar or 0) + (not own.found)
        path = plan.path_world
        if config.follow.shortcut:
            path = shortcut(space, path)
        self.plans.append(np.vstack([leaving, plan.path_world]))
        self.plans_below_margin += kept_m < map_.margin_m
        return np.vstack([leaving, path])
