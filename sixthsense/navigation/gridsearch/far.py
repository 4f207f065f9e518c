"""The cells that are far from all marked ones; where the marks have changed they are computed anew."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.freespace import Bools

_SHAPES = 4
"""shapes of masks that are kept: maps with and without a margin differ by a rim"""


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


class FarCells:
    """`far_from` of masks that change in a few places from one call to the next.

    The cost of a call follows the rectangle that holds all changes. Masks of several shapes are kept apart.
    """

    def __init__(self, reach: int) -> None:
        """Tell the cells more than `reach` rows or columns away from every marked cell."""
        self._reach = reach
        self._latest: dict[tuple[int, ...], tuple[Bools, Bools]] = {}

    def of(self, marked: Bools) -> Bools:
        """(H, W) `far_from` of `marked`, which must not change afterwards; valid until the next call."""
        before = self._latest.pop(marked.shape, None)
        if before is None:
            far = far_from(np.array(marked), self._reach)  # a copy, as below: one type of array for the kernel
        else:
            far = before[1]
            changed = before[0] != marked
            rows, cols = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
            if len(rows):
                outer, inner = zip(
                    *(self._around(places, count) for places, count in zip((rows, cols), marked.shape, strict=True)),
                    strict=True,
                )
                part = tuple(slice(i.start - o.start, i.stop - o.start) for o, i in zip(outer, inner, strict=True))
                far[inner] = far_from(np.array(marked[outer]), self._reach)[part]
        self._latest[marked.shape] = marked, far
        if len(self._latest) > _SHAPES:
            del self._latest[next(iter(self._latest))]
        return far

    def _around(self, places: NDArray[np.int64], count: int) -> tuple[slice, slice]:
        """The rows or columns that decide, and those that are decided, by changes at `places`."""
        first, past, reach = int(places[0]), int(places[-1]) + 1, self._reach
        outer = slice(max(first - 2 * reach, 0), min(past + 2 * reach, count))
        return outer, slice(max(first - reach, 0), min(past + reach, count))
