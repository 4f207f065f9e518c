"""What it costs to go: free cells are cheap, tight ones dear, and those where the robot has been dearer still.

A gap may be closed by the clearance alone, and by cells that are wider than the walls in them. Whether the robot fits
is found by trying: the guard stops it before it touches what its laser sees. So dear cells are opened only along one
way, when no cheaper one is left, and closed again if the robot does not come through.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.driving_limits import track_cells
from sixthsense.navigation.frontier import dilated
from sixthsense.navigation.gridsearch import Prices
from sixthsense.navigation.map_window import MapWindow
from sixthsense.navigation.regions import Cells
from sixthsense.slam.mapping.changes import Box, box_of
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.inflation import marked, too_near

_FREE, _TIGHT, _DRIVEN = np.uint8(1), np.uint8(10), np.uint8(30)
"""a detour over free cells of so many times the length is better"""
_INTO_WALLS = 0.5  # cells that the robot may reach into those of obstacles: a wall is thinner than its cells
_PASSED_M = 0.3  # from the end of a way: a robot so near to it has come through


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

    def free_prices(self, window: MapWindow) -> Prices:
        """The prices of a window's cells for a robot that keeps its clearance."""
        return np.where(window.seen & ~window.blocked, _FREE, np.uint8(0))

    def dear_prices(self, window: MapWindow, grid: Grid, been: Array | None = None) -> Prices:
        """The prices of a window's cells for a robot that may go where it has `been` (N, 2), world frame, if given.

        It may also go where it fits without its clearance, if it is guarded and has not tried in vain.
        """
        prices, (top, left), (height, width) = self.free_prices(window), window.first, window.seen.shape
        box = Box(top, left, top + height, left + width)
        if been is not None:
            track = track_cells(been, (left * window.cell_m, top * window.cell_m), window.cell_m, (height, width))
            prices[track & (prices == 0) & ~self._closed(box, True, grid)] = _DRIVEN
        if self._guarded:
            tight = window.free & window.blocked & ~self._closed(box, False, grid)
            if self._refused:
                # A way as near as the robot is wide is the same one.
                tries = np.sum([too_near(marked(box, way.cells), 2.0 * self._radius) for way in self._refused], axis=0)
                tight &= tries < self._tries
            prices[tight] = _TIGHT
        return prices

    def open(self, window: MapWindow, way: Cells, prices: Prices) -> None:
        """Open the dear cells of a way (N, 2) over a window of such prices."""
        dear = np.flatnonzero(prices[way[:, 0], way[:, 1]] != _FREE)
        if len(dear):
            cells = way[dear[0] : dear[-1] + 2] + np.array(window.first)
            self._untried.append(OpenWay(cells, bool((prices[way[:, 0], way[:, 1]] == _DRIVEN).any())))

    def moved(self, position: Array) -> None:
        """Take in where the robot is, (2,): a way stays open if it has come to its end."""
        passed = [math.dist(position, (way.cells[-1, ::-1] + 0.5) * self._cell_m) <= _PASSED_M for way in self._untried]
        self._passed += [way for way, through in zip(self._untried, passed, strict=True) if through]
        self._untried = [way for way, through in zip(self._untried, passed, strict=True) if not through]

    def close_untried(self) -> None:
        """Close the ways that the robot has not come through; after a few tries for good."""
        self._refused += self._untried
        self._untried = []

    def unblock(self, blocked: Bools, space: FreeSpace, grid: Grid) -> None:
        """Clear the `blocked` cells (H, W) of a space along the open ways where the robot fits."""
        first = round(space.origin[1] / space.cell_m), round(space.origin[0] / space.cell_m)
        for way in self._passed + self._untried:
            rows, cols = box_of(way.cells).grown(1).within(first, blocked.shape)
            part = blocked[rows, cols]
            if part.size:
                inside = Box(first[0] + rows.start, first[1] + cols.start, first[0] + rows.stop, first[1] + cols.stop)
                along = dilated(marked(inside.grown(1), way.cells))[1:-1, 1:-1]
                part &= ~along | self._closed(inside, way.driven, grid)

    def _closed(self, box: Box, driven: bool, grid: Grid) -> Bools:
        """(H, W) the cells of a box where the robot may not go, though it has `driven` there or has no clearance."""
        if driven and self._guarded:  # the guard stops it before it touches anything
            return np.zeros((box.bottom - box.top, box.right - box.left), dtype=np.bool_)
        into_walls = 0.0 if driven else _INTO_WALLS * self._cell_m
        return grid.inflated(box, -self._clearance_m - into_walls)
