"""The views of cells, or that none is worth while, remembered while the map around them stays as it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sixthsense.navigation.gridsearch.reached import TILE
from sixthsense.navigation.viewpoints import Cell
from sixthsense.slam.mapping.freespace import Bools


class View(NamedTuple):
    """What a search for the view of a cell has found."""

    cell: Cell | None
    """the cell to look from, from the world's origin; None if no view from a cell in reach is worth while"""
    shown: int
    """how many cells it shows"""
    span: int
    """rows and columns around the cell that determine this"""


class KnownViews:
    """Remembers what searches for views have found: far from the robot little changes between two searches.

    Cells are counted from the world's origin.
    """

    def __init__(self) -> None:
        """Begin without a view."""
        self._views: dict[Cell, View] = {}
        self._ignored: set[Cell] = set()

    def forget(self, changed: Bools, first: Cell) -> None:
        """Forget the views near the tiles (R, C) of a map that have changed; its cell (0, 0) is `first`."""
        if self._views and changed.any():
            count = np.pad(changed.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))  # in the tiles from the corner on
            known = list(self._views)
            cells = np.array(known) - first
            spans = np.array([view.span for view in self._views.values()])[:, None]
            most = np.array(changed.shape)
            (top, left) = np.clip((cells - spans) // TILE, 0, most).T
            (bottom, right) = np.clip((cells + spans) // TILE + 1, 0, most).T
            near = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0
            for k in np.flatnonzero(near).tolist():
                del self._views[known[k]]
        self._ignored.intersection_update(self._views)

    def add(self, cell: Cell, view: View) -> None:
        """Remember what a search in the latest map has found."""
        self._views[cell] = view

    def get(self, cell: Cell) -> View | None:
        """What is remembered of a cell of the latest map."""
        return self._views.get(cell)

    def ignores(self, cell: Cell) -> bool:
        """Whether the view of a cell is ignored."""
        return cell in self._ignored

    @property
    def shown_by_ignored(self) -> int:
        """How many cells the views that are ignored show together."""
        return sum(self._views[cell].shown for cell in self._ignored)

    def worthwhile(self, cells: list[Cell], dust: float) -> list[int]:
        """The indices of the cells whose views are not ignored, of those whose view is remembered.

        The views that show least are ignored while together they show at most `dust` cells, and until the map around
        them changes. Else small views would take turns, and the robot would cross the building for each.
        """
        shown = [self._views[cell].shown for cell in cells]
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
