"""The part of the map that an exploration works on, and how often each of its cells was not seen from a viewpoint."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.navigation.regions import Cells
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_SEEN_FRACTION = 0.2  # a target is seen when no more than this share of it is unknown

Region = tuple[float, float, float, float]
"""x0, y0, x1, y1, world frame, metres."""

NOWHERE = 0, 0, 0, 0
"""No rows and columns."""


@dataclass(frozen=True, slots=True, eq=False)
class MapWindow:
    """The part of the map within the driving limits; masks (H, W)."""

    first: tuple[int, int]
    """row, col of the masks' corner, counted from the world's origin"""
    cell_m: float
    """side of a cell, metres"""
    seen: Bools
    """crossed by a beam"""
    obstacles: Bools
    """not inflated"""
    blocked: Bools
    """inflated"""
    unseen: Bools
    """within the region, and neither seen nor an obstacle"""
    inside: tuple[int, int, int, int] = NOWHERE
    """first row, past row, first col, past col of the region"""

    @classmethod
    def of(cls, grid: Grid, space: FreeSpace, limits: tuple[slice, slice], region: Region) -> MapWindow:
        """The rows and columns `limits` of a free space and of the grid it was made from."""
        cell_m = space.cell_m
        first = round(space.origin[1] / cell_m), round(space.origin[0] / cell_m)
        obstacles = grid.obstacles
        if obstacles.shape != space.blocked.shape:  # else they cover the same cells: a space holds those of its grid
            own, obstacles = obstacles, np.zeros(space.blocked.shape, dtype=np.bool_)
            row, col = round(grid.origin[1] / cell_m) - first[0], round(grid.origin[0] / cell_m) - first[1]
            obstacles[row : row + own.shape[0], col : col + own.shape[1]] = own
        x0, y0, x1, y1 = region
        corner = first[0] + limits[0].start, first[1] + limits[1].start
        y = (np.arange(limits[0].start, limits[0].stop) + first[0] + 0.5) * cell_m
        x = (np.arange(limits[1].start, limits[1].stop) + first[1] + 0.5) * cell_m
        seen, obstacles = space.seen[limits], obstacles[limits]
        unseen = ~(seen | obstacles)
        (top, below), (left, right) = _between(y, y0, y1), _between(x, x0, x1)
        unseen[:top], unseen[below:], unseen[:, :left], unseen[:, right:] = False, False, False, False
        return cls(corner, cell_m, seen, obstacles, space.blocked[limits], unseen, (top, below, left, right))

    @property
    def free(self) -> Bools:
        """Seen, and no obstacle."""
        return self.seen & ~self.obstacles

    @property
    def unknown(self) -> Bools:
        """Neither seen nor an obstacle, in the region or outside it."""
        return ~(self.seen | self.obstacles)

    def cell(self, point: Array) -> tuple[int, int]:
        """Row and col of a (2,) point, world frame, clipped to the masks."""
        row = math.floor(point[1] / self.cell_m) - self.first[0]
        col = math.floor(point[0] / self.cell_m) - self.first[1]
        height, width = self.seen.shape
        return min(max(row, 0), height - 1), min(max(col, 0), width - 1)

    def point(self, row: float, col: float) -> Array:
        """(2,) centre of a cell, world frame."""
        return np.array([(self.first[1] + col + 0.5) * self.cell_m, (self.first[0] + row + 0.5) * self.cell_m])


def _between(ascending: Array, low: float, high: float) -> tuple[int, int]:
    """First index and index past the last of the numbers between `low` and `high`, exclusive."""
    first = int(np.searchsorted(ascending, low, side="right"))
    return first, max(int(np.searchsorted(ascending, high, side="left")), first)


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Unseen cells and the cell to see them from."""

    cells: Cells
    """(N, 2) unseen cells, row and col counted from the world's origin"""
    viewpoint: tuple[int, int]
    """the cell to see them from, counted likewise"""
    dear: bool = False
    """whether only ways over dear cells lead to the viewpoint"""

    def viewpoint_in(self, window: MapWindow) -> tuple[int, int]:
        """Row and col of the viewpoint in a window."""
        return self.viewpoint[0] - window.first[0], self.viewpoint[1] - window.first[1]

    def mask(self, window: MapWindow) -> Bools:
        """(H, W) the target's cells in a window."""
        mask = np.zeros(window.unseen.shape, dtype=np.bool_)
        cells = self.cells - window.first
        mask[cells[:, 0], cells[:, 1]] = True
        return mask

    def is_seen(self, grid: Grid) -> bool:
        """Whether little of it is still unknown."""
        return bool(np.count_nonzero(grid.unknown(self.cells)) <= _SEEN_FRACTION * len(self.cells))


NO_TARGET = Target(np.zeros((0, 2), dtype=np.int64), (0, 0))


class FailedViewCounts:
    """How often each cell was not seen from a viewpoint chosen for it.

    Counts are kept for all cells of all windows so far, since a grid drawn again may cover fewer cells.
    """

    def __init__(self) -> None:
        self._all: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
        self._first = (0, 0)

    def within(self, window: MapWindow) -> NDArray[np.uint8]:
        """(H, W) the counts of a window's cells; writing to the array changes the counts."""
        corner, shape = window.first, window.seen.shape
        old, first = self._all, self._first
        low, high = np.array(corner), np.add(corner, shape)
        if old.size:
            low, high = np.minimum(low, first), np.maximum(high, np.add(first, old.shape))
        if not old.size or (high - low != old.shape).any():
            rows, cols = (high - low).tolist()
            self._all = np.zeros((rows, cols), dtype=np.uint8)
            row, col = first[0] - int(low[0]), first[1] - int(low[1])
            if old.size:
                self._all[row : row + old.shape[0], col : col + old.shape[1]] = old
            self._first = int(low[0]), int(low[1])
        row, col = corner[0] - self._first[0], corner[1] - self._first[1]
        return self._all[row : row + shape[0], col : col + shape[1]]

    def count_failure(self, window: MapWindow, cells: Bools) -> None:
        """Count one more failed view of (H, W) `cells`."""
        counts = self.within(window)
        counts[cells & (counts < np.iinfo(counts.dtype).max)] += 1
