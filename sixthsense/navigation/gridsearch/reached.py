"""The cells that ways lead to from one cell, found anew where the map has changed.

The map is divided into squares. Within a square, connected passable cells are a part; parts of neighbouring squares are
joined where a step leads from one to the other. A change costs what its squares hold, and the joining of all parts.
Joined parts are a forest of numbers, in which each leads to the first one of its part (union-find).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping import changes
from sixthsense.slam.mapping.freespace import Bools

Numbers = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def root_of(root: Numbers, i: int) -> int:
    """The first of the part of i; makes the way to it shorter."""
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@numba.njit(cache=True, error_model="numpy")
def join(root: Numbers, i: int, j: int) -> None:
    """Make one part of those of i and j."""
    a, b = root_of(root, i), root_of(root, j)
    root[max(a, b)] = min(a, b)


SQUARE = changes.TILE
"""cells; side of the squares"""
TILE = 8
"""cells; side of the tiles by which changes are told"""

Parts = NDArray[np.uint16]
"""(H, W) of each cell the number of its part within its square, from 1; 0: not passable."""


class Reached:
    """The cells that ways over passable cells lead to; diagonal steps cut no corner of blocked ones."""

    def __init__(self, cells: Bools) -> None:
        """Begin with no passable cell, and with the `cells` (H, W) that an earlier search has reached.

        Both sides of the map are multiples of `SQUARE`.
        """
        self.cells = cells
        """(H, W) those that the latest search has reached"""
        squares = cells.shape[0] // SQUARE, cells.shape[1] // SQUARE
        self._parts: Parts = np.zeros(cells.shape, dtype=np.uint16)
        self._counts: Numbers = np.zeros(squares, dtype=np.int64)
        self._stale: Bools = np.ones(squares, dtype=np.bool_)
        self._before = np.zeros(0, dtype=np.bool_), np.zeros(squares, dtype=np.int64)

    def redraw(self, passable: Bools, blocked: Bools, rows: slice, cols: slice) -> None:
        """Find the parts of the squares of some rows and columns, in which `passable` or `blocked` (H, W) differ."""
        squares = (
            slice(rows.start // SQUARE, -(-rows.stop // SQUARE)),
            slice(cols.start // SQUARE, -(-cols.stop // SQUARE)),
        )
        _label(passable, blocked, self._parts, self._counts, *((s.start, s.stop) for s in squares))
        self._stale[squares] = True

    def search(self, blocked: Bools, row: int, col: int, changed: Bools) -> None:
        """Find what is reached from a cell, and set the tiles of `changed`, of `TILE` cells, in which that differs."""
        first = np.cumsum(self._counts.ravel()).reshape(self._counts.shape) - self._counts
        flags = _reached_parts(self._parts, first, int(self._counts.sum()), blocked, row, col)
        _mark(self.cells, self._parts, (flags, first), self._before, self._counts, self._stale, changed)
        self._before = flags, first
        self._stale[:] = False


@numba.njit(cache=True, error_model="numpy")
def _label(
    passable: Bools, blocked: Bools, parts: Parts, counts: Numbers, rows: tuple[int, int], cols: tuple[int, int]
) -> None:
    """Number the parts of the squares in some rows and columns of squares."""
    stack = np.empty((SQUARE * SQUARE, 2), dtype=np.int64)
    for square_row in range(rows[0], rows[1]):
        for square_col in range(cols[0], cols[1]):
            top, left = square_row * SQUARE, square_col * SQUARE
            parts[top : top + SQUARE, left : left + SQUARE] = 0
            count = 0
            for row in range(top, top + SQUARE):
                for col in range(left, left + SQUARE):
                    if parts[row, col] > 0 or not passable[row, col]:
                        continue
                    count += 1
                    parts[row, col] = count
                    stack[0, 0], stack[0, 1], size = row, col, 1
                    while size > 0:
                        size -= 1
                        r, c = stack[size]
                        for to_r in range(max(r - 1, top), min(r + 2, top + SQUARE)):
                            for to_c in range(max(c - 1, left), min(c + 2, left + SQUARE)):
                                if parts[to_r, to_c] > 0 or not passable[to_r, to_c]:
                                    continue
                                if may_step(blocked, r, c, to_r, to_c):
                                    parts[to_r, to_c] = count
                                    stack[size, 0], stack[size, 1] = (to_r, to_c)
                                    size += 1
            counts[square_row, square_col] = count


@numba.njit(cache=True, error_model="numpy")
def _reached_parts(parts: Parts, first: Numbers, count: int, blocked: Bools, row: int, col: int) -> Bools:
    """(P,) which of all parts ways lead to from a cell; those of a square begin at `first`."""
    height, width = parts.shape
    root = np.arange(count)
    for r in range(height):
        # All cells of a square's first row; of the others those of its first column.
        step = 1 if r % SQUARE == 0 else SQUARE
        for c in range(0, width, step):
            if parts[r, c] == 0:
                continue
            here = first[r // SQUARE, c // SQUARE] + parts[r, c] - 1
            for to_r in range(max(r - 1, 0), min(r + 2, height)):
                for to_c in range(max(c - 1, 0), min(c + 2, width)):
                    if parts[to_r, to_c] > 0 and may_step(blocked, r, c, to_r, to_c):
                        there = first[to_r // SQUARE, to_c // SQUARE] + parts[to_r, to_c] - 1
                        join(root, here, there)
    reached = np.zeros(count, dtype=np.bool_)
    for r in range(max(row - 1, 0), min(row + 2, height)):
        for c in range(max(col - 1, 0), min(col + 2, width)):
            if parts[r, c] > 0 and may_step(blocked, row, col, r, c):
                reached[root_of(root, first[r // SQUARE, c // SQUARE] + parts[r, c] - 1)] = True
    for part in range(count):
        reached[part] = reached[root_of(root, part)]
    return reached


@numba.njit(cache=True, error_model="numpy")
def _mark(
    cells: Bools,
    parts: Parts,
    now: tuple[Bools, Numbers],
    before: tuple[Bools, Numbers],
    counts: Numbers,
    stale: Bools,
    changed: Bools,
) -> None:
    """Write which cells are reached where that has changed; parts that are not stale are numbered as before."""
    flags, first = now
    old, old_first = before
    for square_row in range(counts.shape[0]):
        for square_col in range(counts.shape[1]):
            begin, count = first[square_row, square_col], counts[square_row, square_col]
            same = not stale[square_row, square_col]
            if same:
                old_begin = old_first[square_row, square_col]
                for k in range(count):
                    same = same and flags[begin + k] == old[old_begin + k]
            if same:
                continue
            for row in range(square_row * SQUARE, (square_row + 1) * SQUARE):
                for col in range(square_col * SQUARE, (square_col + 1) * SQUARE):
                    part = parts[row, col]
                    is_reached = part > 0 and flags[begin + part - 1]
                    if cells[row, col] != is_reached:
                        cells[row, col] = is_reached
                        changed[row // TILE, col // TILE] = True


@numba.njit(cache=True, error_model="numpy")
def may_step(blocked: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether a step to a neighbour cuts no corner of `blocked` (H, W)."""
    return bool(to_row == row or to_col == col or not (blocked[row, to_col] or blocked[to_row, col]))


@numba.njit(cache=True, error_model="numpy")
def far_from(marked: Bools, reach: int) -> Bools:
    """(H, W) the cells more than `reach` rows or columns away from every marked cell."""
    height, width = marked.shape
    far = np.ones((height, width), dtype=np.bool_)
    until = np.full(width, -1)  # the last row that a marked cell of each column reaches
    for row in range(height + reach):
        if row < height:
            for col in range(width):
                if marked[row, col]:
                    until[col] = row + reach
        # The row `reach` before this one has met all marked cells that reach it.
        target = row - reach
        if target < 0:
            continue
        last = -1  # the last column that a marked cell reaches in the target's row
        for col in range(width + reach):
            if col < width and until[col] >= target:
                last = col + reach
            if col >= reach and last >= col - reach:
                far[target, col - reach] = False
    return far
