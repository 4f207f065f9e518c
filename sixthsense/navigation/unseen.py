"""What exploration knows of the map: the part that lies within bounds, what is to be seen there, and what was tried."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.navigation.frontier import Cells
from sixthsense.slam.mapping.freespace import Bools


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The part of the map that lies within bounds; masks (H, W)."""

    first: tuple[int, int]
    """row, col of the masks' corner, counted from the world's origin"""
    cell_m: float
    """side of a cell"""
    seen: Bools
    """crossed by a beam"""
    obstacles: Bools
    """not inflated"""
    blocked: Bools
    """inflated"""
    unseen: Bools
    """within the region, and neither seen nor an obstacle"""

    @property
    def free(self) -> Bools:
        """Seen, and no obstacle."""
        return self.seen & ~self.obstacles

    @property
    def dark(self) -> Bools:
        """Neither seen nor an obstacle, in the region or about it."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """What the robot is on its way to see."""

    cells: Cells
    """(N, 2) unseen cells, row and col counted from the world's origin"""
    viewpoint: tuple[int, int]
    """the cell to see them from, the same"""
    hidden: bool
    """they are in view from no cell that can be reached"""


class Tries:
    """How often each cell was looked for in vain; kept beyond any view, for a grid drawn anew may cover less."""

    def __init__(self) -> None:
        self._all: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
        self._first = (0, 0)

    def within(self, corner: tuple[int, int], shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """The part, to be written to, of a view whose corner is that cell, counted from the world's origin."""
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
