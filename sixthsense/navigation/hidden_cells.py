"""The views of cells, or that none is worth while, remembered while the map around them stays as it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.map_window import MapWindow
from sixthsense.slam.mapping.freespace import Bools

_TILE = 8
"""cells; changes are kept by squares of so many"""


View = tuple[tuple[int, int], int]
"""Row and col to look from, and how many cells that shows."""


class HiddenCells:
    """Remembers what searches for views have found: far from the robot little changes between two searches."""

    def __init__(self, reach: float) -> None:
        """Remember what a search within `reach`, in cells, has found."""
        self._span = int(reach)
        self._cells: dict[tuple[int, int], bool] = {}
        self._views: dict[tuple[int, int], View] = {}
        self._ignored: set[tuple[int, int]] = set()
        self._first = (0, 0)
        none = np.zeros((0, 0), dtype=np.bool_)
        self._latest = none, none, none

    def update(self, window: MapWindow, reachable: Bools) -> None:
        """Take in another map, of which the cells `reachable` (H, W) can be reached; forget the cells near changes."""
        changed = self._changed(window, reachable)
        if changed is None:
            self.clear()
        elif changed.any():
            count = np.pad(changed.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
            for known in (self._cells, self._views):
                for cell in self._near(count, list(known)):
                    del known[cell]
            self._ignored.intersection_update(self._views)

    def _near(self, count: NDArray[np.int64], known: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Which cells are near a change; `count` has the sums of the squares with a change, from the corner."""
        if not known:
            return []
        # A search looks at the square of `span` cells around a cell.
        cells = np.array(known)
        low = np.maximum(cells - self._span, 0) // _TILE
        past = np.minimum((cells + self._span) // _TILE + 1, np.array(count.shape) - 1)
        (top, left), (bottom, right) = low.T, past.T
        near = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0
        return [known[k] for k in np.flatnonzero(near).tolist()]

    def clear(self) -> None:
        """Forget all cells, since something else is sought."""
        self._cells.clear()
        self._views.clear()
        self._ignored.clear()

    def _changed(self, window: MapWindow, reachable: Bools) -> Bools | None:
        """(H, W) the squares of `_TILE` cells with a change; None if the window is another one."""
        first, latest, before = window.first, (reachable, window.obstacles, window.seen), self._latest
        self._first, self._latest, same = first, latest, first == self._first and reachable.shape == before[0].shape
        if not same:
            return None
        changed = np.zeros(np.add(reachable.shape, _TILE - 1) // _TILE, dtype=np.bool_)
        for now, then in zip(latest, before, strict=True):
            differs = now != then
            rows = np.flatnonzero(differs.any(axis=1))
            where, cols = np.nonzero(differs[rows])
            changed[rows[where] // _TILE, cols // _TILE] = True
        return changed

    def add(self, row: int, col: int, everywhere: bool = False) -> None:
        """Remember a cell of the latest map: hidden from cells in reach, or from `everywhere` the robot would fit."""
        self._cells[row, col] = everywhere

    def has(self, row: int, col: int, everywhere: bool = False) -> bool:
        """Whether a cell of the latest map is remembered; with `everywhere`, as hidden from wherever it would fit."""
        return self._cells.get((row, col), False) if everywhere else (row, col) in self._cells

    def keep(self, row: int, col: int, view: View) -> None:
        """Remember the view of a cell of the latest map."""
        self._views[row, col] = view

    def view(self, row: int, col: int) -> View | None:
        """The view that is remembered of a cell of the latest map."""
        return self._views.get((row, col))

    def worthwhile(self, cells: list[tuple[int, int]], dust: float) -> list[int]:
        """The indices of the cells whose views are not ignored, of those whose view is remembered.

        The views that show least are ignored while together they show at most `dust` cells, and until the map around
        them changes. Else small views would take turns, and the robot would cross the building for each.
        """
        shown = [self._views[cell][1] for cell in cells]
        spare = dust - sum(count for cell, count in zip(cells, shown, strict=True) if cell in self._ignored)
        kept = []
        for k in sorted(range(len(cells)), key=shown.__getitem__):
            if cells[k] in self._ignored:
                continue
            spare -= shown[k]
            if spare >= 0.0:
                self._ignored.add(cells[k])
            else:
                kept.append(k)
        return kept
