"""The cells that paths lead to from the robot, kept up to date where the map changes."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.distances import flood, may_step
from sixthsense.slam.mapping.freespace import Bools

_MAX_SHARE = 0.25  # of all cells: when changes spread over more of them, all are flooded anew

Labels = NDArray[np.int32]
"""(H, W) number of the connected part a cell is in, from 1; 0 for none."""


class ReachableCells:
    """`flood` from a cell that moves, in a map that changes in a few places from one call to the next.

    The box around the changes, with a rim of unchanged cells, is labelled in the map before and after. Cells outside
    stay connected if the cells of the rim that were connected within the box still are. Else all is flooded anew.
    """

    def __init__(self) -> None:
        """Begin without a map."""
        none = np.zeros((0, 0), dtype=np.bool_)
        self._passable, self._blocked, self._reached = none, none, none
        self._first = (0, 0)

    def of(self, passable: Bools, blocked: Bools, first: tuple[int, int], here: tuple[int, int]) -> Bools:
        """(H, W) the cells that paths over `passable` lead to from `here`; masks must not change afterwards.

        `first` is the cell (0, 0) of the masks, counted from the world's origin.
        """
        is_same = first == self._first and passable.shape == self._passable.shape
        if not (is_same and passable[here] and self._update(passable, blocked, here)):
            self._reached = np.zeros(passable.shape, dtype=np.bool_)
            flood(self._reached, passable, blocked, *here)
        # From a cell that is not passable itself the next call cannot go on.
        self._first = first if passable[here] else (2**62, 0)
        self._passable, self._blocked = passable, blocked
        return self._reached.copy()

    def _update(self, passable: Bools, blocked: Bools, here: tuple[int, int]) -> bool:
        """Bring the reached cells up to date, if that can be done from around the changes."""
        changed = (passable != self._passable) | (blocked != self._blocked)
        rows = np.flatnonzero(changed.any(axis=1))
        if len(rows) == 0:
            return bool(self._reached[here])
        cols = np.flatnonzero(changed[rows[0] : rows[-1] + 1].any(axis=0))
        height, width = passable.shape
        top, left = max(int(rows[0]) - 1, 0), max(int(cols[0]) - 1, 0)
        below, right = min(int(rows[-1]) + 2, height), min(int(cols[-1]) + 2, width)
        if (below - top) * (right - left) > _MAX_SHARE * passable.size:
            return False
        part = slice(top, below), slice(left, right)
        reached = self._reached[part]
        before = connected_parts(reached.copy(), self._blocked[part].copy())
        after = connected_parts(passable[part].copy(), blocked[part].copy())
        rim = np.zeros(reached.shape, dtype=np.bool_)
        rim[0], rim[-1] = top > 0, below < height
        rim[:, 0] |= left > 0
        rim[:, -1] |= right < width
        old, new = before[rim & reached], after[rim & reached]
        # Each part that was connected leads into one that is connected.
        to = np.zeros(int(before.max(initial=0)) + 1, dtype=np.int32)
        to[old] = new
        if (to[old] != new).any():
            return False
        kept = np.zeros(int(after.max(initial=0)) + 1, dtype=np.bool_)
        kept[new] = True
        inside = top <= here[0] < below and left <= here[1] < right
        if not (kept[after[here[0] - top, here[1] - left]] if inside else self._reached[here]):
            return False
        onward = np.argwhere(rim & kept[after] & ~reached)
        self._reached[part] = kept[after]
        for row, col in onward.tolist():
            flood(self._reached, passable, blocked, top + row, left + col)
        return True


@numba.njit(cache=True, error_model="numpy")
def connected_parts(passable: Bools, blocked: Bools) -> Labels:
    """(H, W) the parts of `passable` whose cells are connected by the steps of `Distances`."""
    height, width = passable.shape
    labels = np.zeros((height, width), dtype=np.int32)
    stack = np.empty(height * width, dtype=np.int32)
    parts = 0
    for row in range(height):
        for col in range(width):
            if not passable[row, col] or labels[row, col] > 0:
                continue
            parts += 1
            labels[row, col] = parts
            stack[0], size = row * width + col, 1
            while size > 0:
                size -= 1
                r, c = stack[size] // width, stack[size] % width
                for to_r in range(max(r - 1, 0), min(r + 2, height)):
                    for to_c in range(max(c - 1, 0), min(c + 2, width)):
                        if labels[to_r, to_c] == 0 and passable[to_r, to_c] and may_step(blocked, r, c, to_r, to_c):
                            labels[to_r, to_c] = parts
                            stack[size] = to_r * width + to_c
                            size += 1
    return labels
