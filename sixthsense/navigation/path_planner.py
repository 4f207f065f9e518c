"""Planning one path: out of the inflation, with a margin, by the configured planner, with shortcuts.

How far paths keep from obstacles is a margin beyond the inflation, as long as the detour is short. It is the sum of a
chance constraint on the robot's position and the stopping distance. The chance constraint takes an obstacle as a half
plane (Blackmore, Ono, Williams, IEEE T-RO 27(6), 2011, section III): the position error across it exceeds z(p) standard
deviations with probability 1 - p. The standard deviation is at most the root of the larger eigenvalue of the position's
covariance. This margin is conservative, since obstacles were mapped from the same pose: the robot's position relative
to them is more certain than its position in the world. It is therefore capped, and reduced where it would close a
passage.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from sixthsense.config import Config
from sixthsense.config.parts import PLANNERS
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.config.tree import check_returned
from sixthsense.core.geometry import Array
from sixthsense.navigation.guard import latency_s, stopping_distance
from sixthsense.navigation.planners import Plan, Planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import path_is_free, shortcut
from sixthsense.navigation.ways import way_out
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.inflation import giving_way

_PROBABILITY = 0.999
"""with which a path's margin covers the cross-track error of the position: once in a thousand the guard has to stop"""
DETOUR = 1.2
"""a path with a margin may be this many times as long as the shortest: what a way around one obstacle costs"""
_HALVINGS = 3  # of the margin that is wanted: from none on, a space is made narrower by these shares, step by step

FreeSpaceFunction = Callable[[float, Array, Ellipse | None], FreeSpace]
"""The free space with a margin, metres, that covers (K, 2) places, within an ellipse."""


def margin_m(pose_cov: Array, config: Config) -> float:
    """The margin, metres, that a path should keep beyond the inflation for a pose covariance (3, 3)."""
    a, b, c = pose_cov[0, 0], pose_cov[0, 1], pose_cov[1, 1]
    larger = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    position_error = float(ndtri(_PROBABILITY)) * math.sqrt(max(larger, 0.0))
    braking = stopping_distance(config.robot.speed, latency_s(config), config.robot.deceleration)
    return min(position_error + braking, config.safety.max_margin_m)


def plan_with_margin(
    planners: tuple[AStar, AStar],
    free_space: FreeSpaceFunction,
    start: Array,
    goal: Array,
    wanted_m: float,
    detour: float,
) -> tuple[Plan, FreeSpace, float]:
    """Plan between (2,) points with the wanted margin, or less: the plan, its space, the least margin in it, metres.

    The margin is reduced if there is no path with it, or none that is at most `detour` times as long as the shortest.
    Then the space is made narrower step by step, up to the margin. At each step it stays as wide as before about the
    gaps that the step would close, and about both ends: so a path goes through the middle of a gap. The second planner
    plans with margins and the first without: each reuses its last search, in a similar space.
    """
    ends = np.array([start, goal])
    widest = free_space(0.0, ends, None)
    shortest = planners[0].plan(widest, start, goal)
    if not shortest.found or wanted_m <= 0.0:
        return shortest, widest, 0.0
    longest = detour * shortest.cost
    near = Ellipse(start, goal, longest)  # cells that cannot be part of so short a path are not searched

    def within(space: FreeSpace) -> Plan | None:
        plan = shortest if path_is_free(space, shortest.path_world) else planners[1].plan(space, start, goal)
        return plan if plan.cost <= longest else None

    whole = free_space(wanted_m, ends, near)
    plan = within(whole)
    if plan is not None:
        return plan, whole, wanted_m
    best, space, kept_m, has_gaps = shortest, widest, 0.0, False
    for share in (0.0, *(0.5**k for k in range(_HALVINGS, -1, -1))):
        margin = share * wanted_m
        narrower = whole if share == 1.0 else free_space(margin, ends, near)
        gaps = np.vstack(
            [
                _gaps(narrower, best.path_world, max(0.5 * margin, narrower.cell_m)),
                *(p[None] for p in ends if narrower.is_blocked(p)),
            ]
        )
        if len(gaps):
            narrower = giving_way(narrower, space, gaps, margin)
        plan = within(narrower)
        if plan is None:
            break
        has_gaps |= len(gaps) > 0
        best, space, kept_m = plan, narrower, kept_m if has_gaps else margin
    return best, space, kept_m


def _gaps(space: FreeSpace, path_world: Array, spacing_m: float) -> Array:
    """(K, 2) places along a path (N, 2), by cells, where it passes from one connected part of a space to another.

    They are at most `spacing_m` apart.
    """
    # Consecutive points of the path lie in neighbouring cells or in one cell.
    cells = np.array([space.cell_of(point) for point in path_world])
    free = ~space.blocked
    rows, cols = (np.flatnonzero(free.any(axis=axis)) for axis in (1, 0))
    first = np.array([rows[0], cols[0]]) if len(rows) else np.zeros(2, dtype=np.int64)
    part = np.zeros(len(cells), dtype=np.int64)
    if len(rows):
        parts, _ = ndimage.label(free[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1])
        row, col = (cells - first).T
        inside = (row >= 0) & (row < parts.shape[0]) & (col >= 0) & (col < parts.shape[1])
        part[inside] = parts[row[inside], col[inside]]
    inside = np.flatnonzero(part)
    leaves = np.flatnonzero((np.diff(inside) > 1) & (np.diff(part[inside]) != 0))
    step = max(1, math.floor(spacing_m / (math.sqrt(2.0) * space.cell_m)))
    places = [path_world[inside[k] + 1 : inside[k + 1]] for k in leaves]
    return np.vstack([np.zeros((0, 2)), *(np.vstack([place[::step], place[-1:]]) for place in places)])


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
        self.tours: list[Array] = []
        """way points (N, 2) of each tour by which an exploration chose a view: robot, views, home; world frame"""
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
        free_goal = space.nearest_free(goal, GOAL_SLACK_M - config.follow.distance_slack_m)
        goal = goal if free_goal is None else free_goal
        plan, space, kept_m = plan_with_margin(self._astar, map_.free_space, start, goal, map_.margin_m, DETOUR)
        if not plan.found:
            return None
        if self._planner is not None:
            own = self._planner.plan(space, start, goal)
            if config.planner not in PLANNERS.shipped:
                check_returned(f"planner {config.planner}", "plan", own, Plan, path_world=(None, 2))
            plan = own if own.found else plan
            self.plans_by_astar = (self.plans_by_astar or 0) + (not own.found)
        path = shortcut(space, plan.path_world)
        self.plans.append(np.vstack([leaving, plan.path_world]))
        self.plans_below_margin += kept_m < map_.margin_m
        return np.vstack([leaving, path])
