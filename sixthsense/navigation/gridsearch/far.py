"""The cells that are far from all marked ones; where the marks have changed they are computed anew."""

from __future__ import annotations

import numba
import numpy as np

from sixthsense.slam.mapping.changes import Changes, Revision
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

    The cost of a call follows the box that holds all changes. Masks of several shapes are kept apart.
    """

    def __init__(self, reach: int) -> None:
        """Tell the cells more than `reach` rows or columns away from every marked cell."""
        self._reach = reach
        self._latest: dict[tuple[tuple[int, int], tuple[int, ...]], tuple[Revision, Bools]] = {}

    def of(self, marked: Bools, first: tuple[int, int], changes: Changes) -> Bools:
        """(H, W) `far_from` of `marked`, whose cell (0, 0) is `first` from the world's origin.

        `marked` is unchanged where the map of `changes` is. The result is valid until the next call.
        """
        key = first, marked.shape
        before = self._latest.pop(key, None)
        box = changes.since(before[0]) if before is not None else None
        if before is None or box is None:
            far = far_from(np.array(marked), self._reach)  # a copy, as below: one type of array for the kernel
        else:
            far = before[1]
            rows, cols = box.within(first, marked.shape)
            if rows.stop > rows.start and cols.stop > cols.start:
                outer, inner = zip(
                    *(self._around(places, count) for places, count in zip((rows, cols), marked.shape, strict=True)),
                    strict=True,
                )
                part = tuple(slice(i.start - o.start, i.stop - o.start) for o, i in zip(outer, inner, strict=True))
                far[inner] = far_from(np.array(marked[outer]), self._reach)[part]
        self._latest[key] = changes.revision, far
        if len(self._latest) > _SHAPES:
            del self._latest[next(iter(self._latest))]
        return far

    def _around(self, changed: slice, count: int) -> tuple[slice, slice]:
        """The rows or columns that decide, and those that are decided, by changes in some of them."""
        first, past, reach = changed.start, changed.stop, self._reach
        outer = slice(max(first - 2 * reach, 0), min(past + 2 * reach, count))
        return outer, slice(max(first - reach, 0), min(past + reach, count))
