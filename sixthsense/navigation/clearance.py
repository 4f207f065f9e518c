"""How far paths keep from obstacles: a margin beyond the inflation, as long as it costs no great detour.

The margin is a chance constraint on the robot's position and room to brake: an obstacle is a half plane, and the error
of the position across it, of standard deviation at most the root of the covariance's larger eigenvalue, exceeds
z(p) of these with probability 1 - p (Blackmore, Ono, Williams, IEEE T-RO 27(6), 2011, section III). Obstacles were
mapped from the same pose, so that the robot is surer of its place among them than of that in the world: the margin is
on the safe side, and is capped and gives way where it would close a passage.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.planners import Plan
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import path_is_free
from sixthsense.navigation.safety import latency_s, stopping_distance
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid

_SQUEEZE_M = 2.0  # longest way out of a place where only the clearance is missing
_ESCAPE_M = 0.5  # longest way out of one where, if the map is right, the robot does not fit


def margin_m(pose_cov: Array, config: Config) -> float:
    """The margin that a path should keep beyond the inflation, metres, for a pose of covariance (3, 3)."""
    a, b, c = pose_cov[0, 0], pose_cov[0, 1], pose_cov[1, 1]
    larger = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    unsure = float(ndtri(config.safety.probability)) * math.sqrt(max(larger, 0.0))
    braking = stopping_distance(config.robot.speed, latency_s(config), config.robot.deceleration)
    return min(unsure + braking, config.safety.max_margin_m)


def plan_with_margin(
    planners: tuple[AStar, AStar],
    free_space: Callable[[float, Array], FreeSpace],
    start: Array,
    goal: Array,
    wanted_m: float,
    detour: float,
) -> tuple[Plan, FreeSpace, float]:
    """Plan between (2,) points with the margin wanted, or less: the plan, its space, the least margin in it, metres.

    `free_space` gives the space with a margin that gives way about (K, 2) places; the second planner is for those with
    one, so that each of the two, which remember, is asked of much the same space again. The margin gives way if there
    is no path with it, or none at most `detour` times as long as the shortest: by half, then wholly where the shortest
    path passes a gap that closes with it, then everywhere.
    """
    ends = np.array([start, goal])
    widest = free_space(0.0, ends)
    shortest = planners[0].plan(widest, start, goal)
    if not shortest.found or wanted_m <= 0.0:
        return shortest, widest, 0.0

    longest = detour * shortest.cost

    def with_margin(margin_m: float, places: Array) -> FreeSpace:
        # What cannot be part of a path that short is not looked at.
        return free_space(margin_m, places).between(start, goal, longest)

    def within(space: FreeSpace) -> Plan | None:
        plan = shortest if path_is_free(space, shortest.path_world) else planners[1].plan(space, start, goal)
        return plan if plan.cost <= longest else None

    whole = with_margin(wanted_m, ends)
    plan = within(whole)
    if plan is not None:
        return plan, whole, wanted_m
    half = with_margin(0.5 * wanted_m, ends)
    plan = within(half)
    if plan is not None:
        return plan, half, 0.5 * wanted_m
    gaps = _gaps(whole, shortest.path_world, 0.5 * wanted_m)
    if len(gaps):
        about = with_margin(wanted_m, np.vstack([ends, gaps]))
        plan = within(about)
        if plan is not None:
            return plan, about, 0.0
    return shortest, widest, 0.0


def _gaps(space: FreeSpace, path_world: Array, spacing_m: float) -> Array:
    """(K, 2) places, at most so far apart, where a path (N, 2) by cells passes from one part of a space to another."""
    parts, _ = ndimage.label(~space.blocked)
    # Two neighbours on the path are next to each other, or in one cell.
    cells = np.array([space.cell_of(point) for point in path_world])
    part = parts[cells[:, 0], cells[:, 1]]
    inside = np.flatnonzero(part)
    leaves = np.flatnonzero((np.diff(inside) > 1) & (np.diff(part[inside]) != 0))
    step = max(1, math.floor(spacing_m / (math.sqrt(2.0) * space.cell_m)))
    places = [path_world[inside[k] + 1 : inside[k + 1]] for k in leaves]
    return np.vstack([np.zeros((0, 2)), *(np.vstack([place[::step], place[-1:]]) for place in places)])


def way_out(grid: Grid, space: FreeSpace, start: Array, clearance_m: float) -> Array | None:
    """The way from a (2,) place inside the inflation to the nearest free one, by cells; (N, 2) metres, None if none is.

    First through what the inflation covers beyond the robot's own disc, which is as safe as the map is; else, where
    noise has put the robot inside the disc about an obstacle, a short way through anything but obstacles.
    """
    for less_m, within_m in ((clearance_m, _SQUEEZE_M), (math.inf, _ESCAPE_M)):
        inner = grid.free_space(start, margin_m=-less_m)
        path = _nearest(inner, space, start, within_m)
        if path is not None:
            return path
    return None


def _nearest(inner: FreeSpace, outer: FreeSpace, start: Array, within_m: float) -> Array | None:
    """Shortest 8-connected way over free cells of `inner` from `start` to a cell that is free in `outer`, too."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    reach = math.ceil(within_m / inner.cell_m) + 1
    row, col = inner.cell_of(start)
    if inner.is_blocked(start):
        return None
    offsets = np.arange(-reach, reach + 1)
    down, across = (round((inner.origin[k] - outer.origin[k]) / inner.cell_m) for k in (1, 0))
    free = ~inner.window(row + offsets, col + offsets)
    wanted = ~outer.window(row + down + offsets, col + across + offsets)
    side = len(offsets)
    cells = np.arange(side * side).reshape(side, side)
    first, second, cost = [], [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: side - down, max(-across, 0) : side - max(across, 0)]
        there = np.s_[down:, max(across, 0) : side + min(across, 0)]
        both = free[here] & free[there]
        if down and across:  # no corner is cut
            both &= free[here[0], there[1]] & free[there[0], here[1]]
        first.append(cells[here][both])
        second.append(cells[there][both])
        cost.append(np.full(np.count_nonzero(both), inner.cell_m * math.hypot(down, across)))
    shape = (side * side, side * side)
    graph = coo_array((np.concatenate(cost), (np.concatenate(first), np.concatenate(second))), shape).tocsr()
    centre = int(cells[reach, reach])
    found = dijkstra(graph, False, [centre], True, limit=within_m)
    way, before = found[0][0], found[1][0]
    way = np.where(wanted.ravel() & free.ravel(), way, np.inf)
    at = int(np.argmin(way))
    if not math.isfinite(way[at]):
        return None
    path = [at]
    while path[-1] != centre:
        path.append(int(before[path[-1]]))
    points = [inner.centre(row + k // side - reach, col + k % side - reach) for k in reversed(path)]
    return np.array([start, *points[1:]])
