"""The views of cells, or that none is worth while, remembered while the map around them stays as it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.viewpoints import Cell
from sixthsense.slam.mapping.freespace import Bools

_TILE = 8
"""cells; changes are kept by squares of so many"""

Masks = tuple[Bools, ...]
"""(H, W) each."""


class View(NamedTuple):
    """What a search for the view of a cell has found."""

    cell: Cell | None
    """the cell to look from; None if no view from a cell in reach is worth while"""
    shown: int
    """how many cells it shows"""
    span: int
    """rows and columns around the cell that determine this"""


class KnownViews:
    """Remembers what searches for views have found: far from the robot little changes between two searches."""

    def __init__(self) -> None:
        """Begin without a map."""
        self._views: dict[Cell, View] = {}
        self._ignored: set[Cell] = set()
        self._first = (0, 0)
        self._masks: Masks = ()

    def update(self, first: Cell, masks: Masks) -> None:
        """Take in the masks of another map, whose cell (0, 0) is `first` from the world's origin.

        What the views depend on are the cells in reach, the obstacles, and the cells wanted. Those near changes are
        forgotten.
        """
        before, self._masks = self._masks, masks
        (down, across), self._first = np.subtract(self._first, first).tolist(), first
        if not before or down < 0 or across < 0 or (np.add(before[0].shape, (down, across)) > masks[0].shape).any():
            self._views.clear()
        elif self._views:
            if down or across:  # the map has grown
                self._views = {
                    _moved(cell, down, across): _seen_from(view, down, across) for cell, view in self._views.items()
                }
                self._ignored = {_moved(cell, down, across) for cell in self._ignored}
            for cell in self._near(_changed(masks, before, (down, across))):
                del self._views[cell]
        self._ignored.intersection_update(self._views)

    def _near(self, changed: Bools) -> list[Cell]:
        """The cells near a change, by the squares with one."""
        count = np.pad(changed.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))  # in the squares from the corner on
        cells, known = np.array(list(self._views)), list(self._views)
        spans = np.array([view.span for view in self._views.values()])[:, None]
        low = np.maximum(cells - spans, 0) // _TILE
        past = np.minimum((cells + spans) // _TILE + 1, np.array(count.shape) - 1)
        (top, left), (bottom, right) = low.T, past.T
        near = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0
        return [known[k] for k in np.flatnonzero(near).tolist()]

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


def _moved(cell: Cell, down: int, across: int) -> Cell:
    return cell[0] + down, cell[1] + across


def _seen_from(view: View, down: int, across: int) -> View:
    return view._replace(cell=None if view.cell is None else _moved(view.cell, down, across))


def _changed(now: Masks, before: Masks, at: Cell) -> Bools:
    """(R, C) the squares of `_TILE` cells with a change; the cell (0, 0) of the masks before is now the cell `at`."""
    (height, width), (rows, cols) = now[0].shape, before[0].shape
    changed: NDArray[np.bool_] = np.zeros(np.add(now[0].shape, _TILE - 1) // _TILE, dtype=np.bool_)
    rim = (at[0], height - rows - at[0]), (at[1], width - cols - at[1])
    for new, old in zip(now, before, strict=True):
        differs = new != (old if new.shape == old.shape else np.pad(old, rim))
        rows_with = np.flatnonzero(differs.any(axis=1))
        where, columns = np.nonzero(differs[rows_with])
        changed[rows_with[where] // _TILE, columns // _TILE] = True
    return changed
