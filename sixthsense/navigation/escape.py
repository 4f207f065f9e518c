"""The way out of the inflation for a robot that noise has put inside it."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import cheapest_way, costs_from
from sixthsense.navigation.gridsearch.prices import STRAIGHT
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_CLEARANCE_LIMIT_M = 2.0  # longest path out of a place where only the clearance is missing
_OVERLAP_LIMIT_M = 0.5  # longest path out of a place where, if the map is right, the robot does not fit


def escape_path(grid: Grid, space: FreeSpace, start: Array, clearance_m: float) -> Array | None:
    """The path (N, 2), by cells, metres, from a (2,) blocked place to the nearest free one; None if there is none.

    The first choice is a path through what only the clearance blocks, which is as safe as the map is. The second is a
    short path through anything but obstacles: noise has put the robot inside the disc around an obstacle.
    """
    for less_m, limit_m in ((clearance_m, _CLEARANCE_LIMIT_M), (math.inf, _OVERLAP_LIMIT_M)):
        inner = grid.free_space(start, margin_m=-less_m, within=Ellipse(start, start, 2.0 * limit_m))
        path = _path_between(inner, space, start, limit_m)
        if path is not None:
            return path
    return None


def _path_between(inner: FreeSpace, outer: FreeSpace, start: Array, limit_m: float) -> Array | None:
    """A shortest path over free cells of `inner` from `start` to a cell that is free in `outer` as well."""
    if inner.is_blocked(start):
        return None
    reach = math.ceil(limit_m / inner.cell_m) + 1
    row, col = inner.cell_of(start)
    offsets = np.arange(-reach, reach + 1)
    down, across = (round((inner.origin[k] - outer.origin[k]) / inner.cell_m) for k in (1, 0))
    free = ~inner.window(row + offsets, col + offsets)
    wanted = ~outer.window(row + down + offsets, col + across + offsets)
    prices = free.astype(np.uint8)
    costs = costs_from(prices, reach, reach)
    reached = wanted & (costs >= 0) & (costs * inner.cell_m <= limit_m * STRAIGHT)
    if not reached.any():
        return None
    nearest = np.argmin(np.where(reached, costs, np.iinfo(costs.dtype).max))
    cells = cheapest_way(prices, costs, *divmod(int(nearest), costs.shape[1]))
    points = [inner.centre(row + int(r) - reach, col + int(c) - reach) for r, c in cells]
    return np.array([start, *points[1:]])
