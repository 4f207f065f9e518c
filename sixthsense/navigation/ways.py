"""What it costs to go: free cells are cheap, tight ones dear, and those where the robot has been dearer still.

A gap may be closed by the clearance alone, and by cells that are wider than the walls in them. Whether the robot fits
is found by trying: the guard stops it before it touches what its laser sees. So dear cells are opened only along one
way, when no cheaper one is left, and closed again if the robot does not come through. A robot that noise has put inside
the inflation leaves it by the cheapest way, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.frontier import dilated
from sixthsense.navigation.gridsearch import Prices, cheapest_way, costs_from
from sixthsense.navigation.gridsearch.prices import STRAIGHT
from sixthsense.navigation.regions import Cells
from sixthsense.slam.mapping.changes import Box, box_of
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.inflation import marked, too_near

_FREE, _TIGHT, _DRIVEN = np.uint8(1), np.uint8(10), np.uint8(30)
"""a detour over free cells of so many times the length is better"""
_OUT_M = 2.0  # longest way out of the inflation over tight cells
_OVERLAP = np.uint8(4)  # on the way out, price of cells where, if the map is right, the robot does not fit


class OpenWay(NamedTuple):
    """Dear cells that the robot may drive over."""

    cells: Cells
    """(N, 2) row and col from the world's origin, in the order of the way"""
    driven: bool
    """whether the robot has been there, though walls may be drawn there now, after errors of its pose"""


class Ways:
    """The prices of cells, and the ways over dear ones that are open."""

    def __init__(self, radius_m: float, config: Config) -> None:
        """Begin with none; a robot without a guard goes back where it has been, but through nothing tight."""
        self._radius, self._cell_m = radius_m / config.grid.cell_m, config.grid.cell_m
        self._clearance_m, self._guarded = config.grid.clearance_m, config.safety.guard
        self._tries = config.explore.tries
        self._passed: list[OpenWay] = []
        self._untried: list[OpenWay] = []
        self._refused: list[OpenWay] = []

    def prices(self, box: Box, passable: Bools, tight: Bools, grid: Grid, been: Array | None = None) -> Prices:
        """(H, W) the prices of the cells of a box for a robot that may go where it has `been` (N, 2), if given.

        It may go where it fits without its clearance, among the cells that may be `tight` (H, W), if it is guarded and
        has not tried in vain.
        """
        prices: Prices = np.where(passable, _FREE, np.uint8(0))
        if been is not None:
            track = marked(box, track_cells(been, self._cell_m))
            prices[track & (prices == 0) & ~self._closed(box, True, grid)] = _DRIVEN
        if self._guarded:
            open_ = tight & ~self._closed(box, False, grid)
            if self._refused:
                # A way as near as the robot is wide is the same one.
                tries = np.sum([too_near(marked(box, way.cells), 2.0 * self._radius) for way in self._refused], axis=0)
                open_ &= tries < self._tries
            prices[open_] = _TIGHT
        return prices

    def open(self, way: Cells, prices: Prices) -> None:
        """Open the dear cells of a way (N, 2), row and col from the world's origin, over cells of `prices` (N,)."""
        dear = np.flatnonzero(prices != _FREE)
        if len(dear):
            self._untried.append(OpenWay(way[dear[0] : dear[-1] + 2], bool((prices == _DRIVEN).any())))

    def moved(self, position: Array) -> bool:
        """Take in where the robot is, (2,): a way stays open if the robot covers its end; whether it has to one."""
        reach_m = self._radius * self._cell_m
        passed = [math.dist(position, (way.cells[-1, ::-1] + 0.5) * self._cell_m) <= reach_m for way in self._untried]
        self._passed += [way for way, through in zip(self._untried, passed, strict=True) if through]
        self._untried = [way for way, through in zip(self._untried, passed, strict=True) if not through]
        return any(passed)

    def close_untried(self) -> list[OpenWay]:
        """Close the ways that the robot has not come through, after a few tries for good; those that were closed."""
        closed, self._untried = self._untried, []
        self._refused += closed
        return closed

    def unblock(self, blocked: Bools, box: Box, grid: Grid) -> None:
        """Clear the `blocked` cells (H, W) of a box along the open ways where the robot fits."""
        for way in self._passed + self._untried:
            rows, cols = box_of(way.cells).grown(1).within((box.top, box.left), blocked.shape)
            part = blocked[rows, cols]
            if part.size:
                inside = Box(box.top + rows.start, box.left + cols.start, box.top + rows.stop, box.left + cols.stop)
                along = dilated(marked(inside.grown(1), way.cells))[1:-1, 1:-1]
                part &= ~along | self._closed(inside, way.driven, grid)

    def _closed(self, box: Box, driven: bool, grid: Grid) -> Bools:
        """(H, W) the cells of a box where the robot may not go, though it has `driven` there or has no clearance."""
        if driven and self._guarded:  # the guard stops it before it touches anything
            return np.zeros((box.bottom - box.top, box.right - box.left), dtype=np.bool_)
        into_walls = 0.0 if driven else 0.5 * self._cell_m  # a wall is thinner than its cells
        return grid.inflated(box, -self._clearance_m - into_walls)


def way_out(grid: Grid, space: FreeSpace, start: Array, clearance_m: float) -> Array | None:
    """The cheapest way (N, 2), by cells, metres, from a (2,) blocked place to a free one; None if none is short.

    What only the clearance blocks is as safe as the map is. What the robot's disc closes is dearer: if the map is
    right, it does not fit there, and noise has put it inside the disc around an obstacle.
    """
    cell_m, reach = space.cell_m, math.ceil(_OUT_M / space.cell_m) + 1
    row, col = (math.floor(start[k] / cell_m) for k in (1, 0))
    box = Box(row - reach, col - reach, row + reach + 1, col + reach + 1)
    overlap, obstacles = grid.inflated(box, -clearance_m), grid.inflated(box, -math.inf)
    prices: Prices = np.where(obstacles, np.uint8(0), np.where(overlap, _OVERLAP, _FREE))
    rows, cols = np.arange(box.top, box.bottom), np.arange(box.left, box.right)
    down, across = round(space.origin[1] / cell_m), round(space.origin[0] / cell_m)
    costs = costs_from(prices, reach, reach)
    reached = ~space.window(rows - down, cols - across) & (costs >= 0) & (costs * cell_m <= _OUT_M * STRAIGHT)
    if not reached.any():
        return None
    nearest = np.argmin(np.where(reached, costs, np.iinfo(costs.dtype).max))
    cells = cheapest_way(prices, costs, *divmod(int(nearest), costs.shape[1])) + np.array([box.top, box.left])
    return np.vstack([start, (cells[1:, ::-1] + 0.5) * cell_m])


def track_cells(positions: Array, cell_m: float) -> Cells:
    """(M, 2) the cells along a path (N, 2), metres, and their neighbours, row and col from the world's origin."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    steps = np.arange(0.0, along[-1] + cell_m, 0.5 * cell_m)
    points = np.column_stack([np.interp(steps, along, positions[:, axis]) for axis in (1, 0)])
    cells = np.unique(np.floor(points / cell_m).astype(np.int64), axis=0)
    beside = np.stack(np.meshgrid(np.arange(-1, 2), np.arange(-1, 2)), axis=-1).reshape(-1, 2)
    return np.unique((cells[:, None] + beside).reshape(-1, 2), axis=0)
