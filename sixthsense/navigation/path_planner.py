"""Planning one path: by the configured planner, through what is free, with shortcuts.

How far a path should keep from obstacles, beyond the robot's disc and the clearance, is the sum of a chance constraint
on the robot's position and the stopping distance. The chance constraint takes an obstacle as a half plane (Blackmore,
Ono, Williams, IEEE T-RO 27(6), 2011, section III): the position error across it exceeds z(p) standard deviations with
probability 1 - p. The standard deviation is at most the root of the larger eigenvalue of the position's covariance.
This is conservative, since obstacles were mapped from the same pose. It is therefore capped, and a wish: what is nearer
to obstacles costs more.
"""

from __future__ import annotations

import math

from scipy import ndimage
from scipy.special import ndtri

from sixthsense.config import Config
from sixthsense.config.parts import PLANNERS
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.config.tree import check_returned
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.clearance import Clearance
from sixthsense.navigation.guard import BUFFER_M, latency_s, least_clearance_m, stopping_distance
from sixthsense.navigation.planners import Plan, Planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import is_free, shortcut
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_PROBABILITY = 0.999
"""with which the wish covers the cross-track error of the position: once in a thousand the guard has to slow down"""


class DrivingMap:
    """The map as it is driven by: the clearance, the robot's pose, and the clearance that is wished for."""

    def __init__(self, radius_m: float, config: Config, stays_near_seen: bool) -> None:
        """Begin without a map, for a disc of `radius_m`; `stays_near_seen`: a radius beyond what was seen at most."""
        self._config, self._own_m = config, radius_m + config.grid.clearance_m
        most_m = self._own_m + config.safety.max_margin_m
        self.usual_m = self.least_m = least_clearance_m(radius_m, config)
        """clearance below which the robot drives nowhere, as a rule and at present"""
        self.shut_in_m = radius_m if config.safety.guard and self.usual_m <= radius_m + BUFFER_M else self.usual_m
        """the same of a robot that knows no way home: the map errs by centimetres, the guard watches"""
        self.clearance = Clearance(config.grid.cell_m, self.usual_m, most_m)
        self.wish_m = self._own_m
        """clearance below which a metre costs more"""
        self._unseen_m = radius_m if stays_near_seen else math.inf

    def update(self, grid: Grid, estimate: Estimate) -> None:
        """Draw the clearance where the grid has changed, and compute what is wished for at the present estimate."""
        self.grid, self.estimate = grid, estimate
        self.clearance.update(grid)
        self.wish_m = self._own_m + _margin_m(estimate.pose_cov, self._config)
        self._space: tuple[tuple[Pose, float], FreeSpace] | None = None

    def free_space(self, pose: Pose) -> FreeSpace:
        """Where a robot at a pose may drive, and what that costs."""
        key = pose, self.least_m
        if self._space is None or self._space[0] != key:
            self._space = key, self.clearance.free_space(self.least_m, self.wish_m, pose.position, self._unseen_m)
        return self._space[1]

    def is_clear(self, path: Array) -> bool:
        """Whether a path (N, 2) is not blocked by now, and passes narrow gaps within half a cell of their middle."""
        # Out of a blocked cell the robot plans anew with each scan.
        return self._avoids(path, self.clearance.metres < self.least_m, 0.5)

    def keeps_wish(self, path: Array) -> bool:
        """Whether a path (N, 2) keeps the clearance that is wished for."""
        below = self.clearance.metres < self.wish_m - 1e-6  # distances have 32 bits
        return self._avoids(path, below, math.inf)

    def _avoids(self, path: Array, barred: Bools, off_middle: float) -> bool:
        cells = (path - self.clearance.origin) / self.clearance.cell_m
        return bool(is_free(barred, self.clearance.offsets, cells, off_middle))


def _margin_m(pose_cov: Array, config: Config) -> float:
    """What a path should keep beyond the clearance, metres, for a pose covariance (3, 3)."""
    a, b, c = pose_cov[0, 0], pose_cov[0, 1], pose_cov[1, 1]
    larger = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    position_error = float(ndtri(_PROBABILITY)) * math.sqrt(max(larger, 0.0))
    braking = stopping_distance(config.robot.speed, latency_s(config), config.robot.deceleration)
    return min(position_error + braking, config.safety.max_margin_m)


class PathPlanner:
    """Plans paths and counts them."""

    def __init__(self, planner: Planner, config: Config) -> None:
        """Plan by `planner`, and by A* where that gives up."""
        self.plans: list[Array] = []
        """every planned path, (N, 2) each, world frame, as it is driven"""
        self.plans_below_margin = 0
        """how many of them have less clearance somewhere than is wished for"""
        self.plans_by_astar: int | None = None if type(planner) is AStar else 0
        """how many of them are A*'s because the configured planner found none; None if that is A*"""
        self._planner, self._config = planner, config
        self._has_path = True  # at the last plan

    def plan(self, map_: DrivingMap, pose: Pose, goal: Array) -> Array | None:
        """The way points (N, 2) from a pose to `goal` (2,); None if there is no path."""
        config, start = self._config, pose.position
        space = map_.free_space(pose).covering(start, goal)
        # A goal just inside what is blocked is reached from the nearest free place within the slack.
        free_goal = space.nearest_free(goal, GOAL_SLACK_M - config.follow.distance_slack_m)
        goal = goal if free_goal is None else free_goal
        # A search without a path visits all cells that are reached. One is enough until the cells are joined.
        if not self._has_path:
            areas, _ = ndimage.label(~space.blocked)
            if areas[space.cell_of(start)] != areas[space.cell_of(goal)]:
                return None
        plan = self._planned(space, start, goal)
        self._has_path = plan.found
        if not plan.found:
            return None
        path = shortcut(space, plan.path_world)
        self.plans.append(path)
        self.plans_below_margin += not map_.keeps_wish(path)
        return path

    def _planned(self, space: FreeSpace, start: Array, goal: Array) -> Plan:
        plan = self._planner.plan(space, start, goal)
        if self.plans_by_astar is None:
            return plan
        if self._config.planner not in PLANNERS.shipped:
            check_returned(f"planner {self._config.planner}", "plan", plan, Plan, path_world=(None, 2))
        if not plan.found:
            plan = AStar().plan(space, start, goal)
            self.plans_by_astar += plan.found
        return plan
