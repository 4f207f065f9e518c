"""Short ways by cells: out of the inflation, and where a path has led.

A robot that noise has put inside the inflation leaves it by the cheapest way.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import Prices, cheapest_way, costs_from
from sixthsense.navigation.gridsearch.prices import STRAIGHT
from sixthsense.navigation.regions import Cells
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid

NEAR_M = 2.0
"""of a way that is led by what is seen of obstacles now, out of the inflation or through a gap; the rest will be seen
better"""
_STEP = 0.1  # cells between the points of a path whose cells are its own: fewer would cut corners
_OVERLAP = np.uint8(4)  # on the way out, price of cells where, if the map is right, the robot does not fit


def way_out(grid: Grid, space: FreeSpace, start: Array, clearance_m: float) -> Array | None:
    """The cheapest way (N, 2), by cells, metres, from a (2,) blocked place to a free one; None if none is short.

    What only the clearance blocks is as safe as the map is. What the robot's disc closes is dearer: if the map is
    right, it does not fit there, and noise has put it inside the disc around an obstacle.
    """
    cell_m, reach = space.cell_m, math.ceil(NEAR_M / space.cell_m) + 1
    row, col = (math.floor(start[k] / cell_m) for k in (1, 0))
    box = Box(row - reach, col - reach, row + reach + 1, col + reach + 1)
    overlap, obstacles = grid.inflated(box, -clearance_m), grid.inflated(box, -math.inf)
    prices: Prices = np.where(obstacles, np.uint8(0), np.where(overlap, _OVERLAP, np.uint8(1)))
    rows, cols = np.arange(box.top, box.bottom), np.arange(box.left, box.right)
    down, across = round(space.origin[1] / cell_m), round(space.origin[0] / cell_m)
    costs = costs_from(prices, reach, reach)
    reached = ~space.window(rows - down, cols - across) & (costs >= 0) & (costs * cell_m <= NEAR_M * STRAIGHT)
    if not reached.any():
        return None
    nearest = np.argmin(np.where(reached, costs, np.iinfo(costs.dtype).max))
    cells = cheapest_way(prices, costs, *divmod(int(nearest), costs.shape[1])) + np.array([box.top, box.left])
    return np.vstack([start, (cells[1:, ::-1] + 0.5) * cell_m])


def track_cells(positions: Array, cell_m: float) -> Cells:
    """(M, 2) the cells along a path (N, 2), metres, row and col from the world's origin."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    steps = np.arange(0.0, along[-1] + cell_m, _STEP * cell_m)
    points = np.column_stack([np.interp(steps, along, positions[:, axis]) for axis in (1, 0)])
    return np.unique(np.floor(points / cell_m).astype(np.int64), axis=0)
