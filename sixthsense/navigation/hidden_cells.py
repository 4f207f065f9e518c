"""Cells that are visible from no reachable cell, remembered while the map around them stays as it is."""

from __future__ import annotations

import numpy as np

from sixthsense.navigation.map_window import MapWindow
from sixthsense.slam.mapping.freespace import Bools


class HiddenCells:
    """Remembers cells that a search has found to be hidden: far from the robot little changes between two searches."""

    def __init__(self, reach: float) -> None:
        """Remember what a search within `reach`, in cells, has found."""
        self._span = int(reach)
        self._cells: set[tuple[int, int]] = set()
        self._first = (0, 0)
        self._latest = np.zeros((2, 0, 0), dtype=np.bool_)

    def update(self, window: MapWindow, reachable: Bools) -> None:
        """Take in another map, of which the cells `reachable` (H, W) can be reached; forget the cells near changes."""
        latest = np.stack([reachable, window.obstacles])
        if window.first != self._first or latest.shape != self._latest.shape:
            self._cells.clear()
        elif self._cells:
            changed = (latest != self._latest).any(axis=0)
            rows, cols = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
            if len(rows):
                low = rows[0] - self._span, cols[0] - self._span
                high = rows[-1] + self._span, cols[-1] + self._span
                self._cells = {
                    cell for cell in self._cells if not (low[0] <= cell[0] <= high[0] and low[1] <= cell[1] <= high[1])
                }
        self._first, self._latest = window.first, latest

    def add(self, row: int, col: int) -> None:
        """Remember a cell of the latest map."""
        self._cells.add((row, col))

    def has(self, row: int, col: int) -> bool:
        """Whether a cell of the latest map is remembered."""
        return (row, col) in self._cells
