"""Where in a scene a robot can move, and where the nearest place is that it can."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from sixthsense.core.geometry import Array

_CELL_M = 0.05
_SLACK_CELLS = 1.5
"""of a distance between cells, so that no place is called unreachable that is not"""
_MOST_CELLS = 1000
"""along a side of the building, where a place is only to be told from furniture"""
_SOLID_SHARE = 0.1
"""of the largest room to move in: what walls enclose that is smaller, and has no door, is furniture"""


class FreeParts:
    """The parts of a scene that a disc can move in, among walls (M, 2, 2), world frame.

    A gap that is narrower than the disc by a cell counts as one that it fits through.
    """

    def __init__(self, walls: Array, places: Array, radius_m: float, is_coarse: bool = False) -> None:
        """Find the parts, in an area that holds the walls and `places` (N, 2); large areas in large cells if coarse."""
        self.radius_m = radius_m
        corners = np.concatenate([walls.reshape(-1, 2), places])
        side_m = float((corners.max(axis=0) - corners.min(axis=0)).max())
        self._cell_m = max(_CELL_M, side_m / _MOST_CELLS) if is_coarse else _CELL_M
        self._low = corners.min(axis=0) - radius_m - 2.0 * self._cell_m
        shape = (
            np.ceil((corners.max(axis=0) + radius_m + 2.0 * self._cell_m - self._low) / self._cell_m).astype(np.int64)
            + 1
        )
        is_free = np.ones(tuple(shape), dtype=np.bool_)
        for first, last in walls:
            steps = math.ceil(2.0 * math.dist(first, last) / self._cell_m) + 1
            x, y = np.floor((np.linspace(first, last, steps) - self._low) / self._cell_m).astype(np.int64).T
            is_free[x, y] = False
        clear = distance_transform_edt(is_free)
        passable, self._is_clear = clear > radius_m / self._cell_m - _SLACK_CELLS, clear > radius_m / self._cell_m + 1.0
        self._parts, count = label(passable, structure=np.ones((3, 3)))
        sizes = np.bincount(self._parts.ravel(), minlength=count + 1)
        edges = (self._parts[0], self._parts[-1], self._parts[:, 0], self._parts[:, -1])
        sizes[np.unique(np.concatenate([[0], *edges]))] = 0  # walls, and what is outside
        self._sizes, self._inside = sizes, int(np.argmax(sizes))

    def _at(self, places: Array) -> NDArray[np.int64]:
        """(N,) the part of each place; 0 for none."""
        rows = np.floor((places - self._low) / self._cell_m).astype(np.int64)
        return np.asarray(self._parts[tuple(rows.T)], dtype=np.int64)

    def connected(self, start: Array, goals: Array) -> NDArray[np.bool_]:
        """(N,) whether the disc may get from `start` (2,) to goals (N, 2)."""
        own, found = self._at(start[None])[0], self._at(goals)
        return np.asarray((found == own) | (own == 0) | (found == 0))

    def is_solid(self, place: Array) -> bool:
        """Whether a place (2,) is enclosed by walls that take up a small share of what other walls enclose."""
        own = int(self._at(place[None])[0])
        return bool(0 < self._sizes[own] < _SOLID_SHARE * self._sizes[self._inside])

    def nearest(self, place: Array) -> Array | None:
        """(2,) the place nearest to `place` (2,) where the disc fits, in the largest part that walls enclose.

        None where they enclose nothing.
        """
        cells = np.argwhere((self._parts == self._inside) & self._is_clear)
        if not self._sizes[self._inside] or not len(cells):
            return None
        centres = self._low + (cells + 0.5) * self._cell_m
        return np.asarray(centres[np.argmin(np.square(centres - place).sum(axis=1))])
