"""Boxes of cells, and where a map has changed, for readers that keep something up to date."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array

MAX_CELLS = 100_000_000
"""Largest grid; more cells come from a wrong pose or range, or from too small a cell."""
MAX_BOX = 10 * MAX_CELLS
"""Cells of the largest box; more come from a wrong pose or range, or from too small a cell."""

SHIFT = 6
"""A tile is 2^6 cells on a side."""
TILE = 1 << SHIFT

Revision = tuple[int, int]
"""State of a map, to ask later what has changed since."""


class Box(NamedTuple):
    """Rows and columns of cells, counted from the world's origin."""

    top: int
    """first row"""
    left: int
    """first column"""
    bottom: int
    """row past the last"""
    right: int
    """column past the last"""

    def grown(self, cells: int) -> Box:
        """The same and the cells around it."""
        return Box(self.top - cells, self.left - cells, self.bottom + cells, self.right + cells)

    def aligned(self, side: int) -> Box:
        """The box of the squares of `side` cells, counted from the world's origin, that it touches."""
        top, left = self.top // side * side, self.left // side * side
        return Box(top, left, -(-self.bottom // side) * side, -(-self.right // side) * side)

    def within(self, first: tuple[int, int], shape: tuple[int, ...]) -> tuple[slice, slice]:
        """The rows and columns of it in an array of `shape` whose cell (0, 0) is `first`."""
        rows = slice(min(max(self.top - first[0], 0), shape[0]), min(max(self.bottom - first[0], 0), shape[0]))
        cols = slice(min(max(self.left - first[1], 0), shape[1]), min(max(self.right - first[1], 0), shape[1]))
        return rows, cols


def box_of(cells: NDArray[Any]) -> Box:
    """The box of (N, 2) cells, N > 0."""
    (top, left), (bottom, right) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    return Box(top, left, bottom + 1, right + 1)


def cell_box(low: Array, high: Array, most: int = MAX_CELLS) -> tuple[tuple[int, int], tuple[int, int]]:
    """Corner (row, col) and shape (H, W) of the cells from (2,) `low` up to `high`, exclusive; both whole numbers.

    Raises InputError when they are more than `most`, or so far out that floats no longer tell them apart.
    """
    height, width = high - low
    if not (height * width <= most and max(np.abs(low).max(), np.abs(high).max()) < 2.0**48):
        raise InputError(
            "grid",
            f"found {height:.4g} x {width:.4g} cells from row {low[0]:.4g}, column {low[1]:.4g}",
            f"at most {most:,} cells, within 2^48 of the origin",
        )
    return (int(low[0]), int(low[1])), (int(height), int(width))


def grown_box(box: Box, low: Array, high: Array) -> Box:
    """The box extended to hold the cells from (2,) `low` up to `high`, exclusive; InputError if that is too large.

    Where it grows it grows by a tile more: so masks are seldom drawn anew, and unknown cells are around the map.
    """
    is_begun = box.bottom > box.top
    old_low, old_high = (np.array(box[:2]), np.array(box[2:])) if is_begun else (high, low)
    low = np.where(low < old_low, low - TILE, old_low)
    high = np.where(high > old_high, high + TILE, old_high)
    (row, col), (height, width) = cell_box(low, high, MAX_BOX)
    return Box(row, col, row + height, col + width)


def moved(cells: NDArray[Any], before: Box, box: Box, fill: float) -> NDArray[Any]:
    """(H, W, ...) what cells of a box have in another box, `fill` outside."""
    shape = box.bottom - box.top, box.right - box.left
    there = np.full((*shape, *cells.shape[2:]), fill, dtype=cells.dtype)
    here = box.within((before.top, before.left), cells.shape)
    there[before.within((box.top, box.left), shape)] = cells[here]
    return there


class Changes:
    """The boxes in which a map has changed, one for each scan."""

    def __init__(self) -> None:
        self._rebuilds = 0
        self._boxes: list[Box] = []

    def add(self, box: Box) -> None:
        """Take in that cells in a box may have changed."""
        self._boxes.append(box)

    def add_all(self) -> None:
        """Take in that any cell may have changed."""
        self._rebuilds += 1
        self._boxes = []

    @property
    def revision(self) -> Revision:
        """The present state of the map."""
        return self._rebuilds, len(self._boxes)

    def since(self, revision: Revision | None) -> Box | None:
        """A box around all changes since a state, of no cells if there are none; None if any cell may have changed."""
        if revision is None or revision[0] != self._rebuilds:
            return None
        boxes = self._boxes[revision[1] :]
        if not boxes:
            return Box(0, 0, 0, 0)
        tops, lefts, bottoms, rights = zip(*boxes, strict=True)
        return Box(min(tops), min(lefts), max(bottoms), max(rights))
