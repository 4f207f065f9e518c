"""Lengths of the shortest paths from one cell to others, searched as far as somebody asks."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.bucket_queue import Sizes, Stacks, push
from sixthsense.slam.mapping.freespace import Bools

Costs = NDArray[np.float32]
Cell = tuple[int, int]

_SQRT2 = math.sqrt(2.0)
_BUCKETS = 8  # each a quarter of a cell wide: a step is at most sqrt 2
_START = np.float32(1e-30)  # instead of 0; added to the length of a step it makes no difference
_STEP = 1.5  # growth of the radius that is searched from one look at the result to the next


class Distances:
    """Lengths, in cells, of the shortest 8-connected paths over `passable` from one cell.

    Dijkstra's search with a ring of buckets, which goes on from where it stopped. A cell that improves after its
    expansion is expanded again.
    """

    def __init__(self, passable: Bools, blocked: Bools, row: int, col: int, reachable: Bools | None = None) -> None:
        """Begin at a cell; masks (H, W) must not change. Diagonal steps cut no corner of `blocked`.

        `reachable` are the cells that a path leads to, if they are known.
        """
        self._passable, self._blocked = passable, blocked
        self._here = row, col
        self._reachable = reachable
        # 0 where not reached: pages of memory that are never written to cost nothing.
        self._cost: Costs = np.zeros(passable.shape, dtype=np.float32)
        self._cost[row, col] = _START
        self._stacks: Stacks = np.empty((_BUCKETS, 1024), dtype=np.int32)
        self._sizes: Sizes = np.zeros(_BUCKETS, dtype=np.int64)
        self._stacks[0, 0], self._sizes[0] = row * passable.shape[1] + col, 1
        self._bucket = 0

    @property
    def reachable(self) -> Bools:
        """(H, W) the cells that a path leads to."""
        if self._reachable is None:
            self._reachable = np.zeros(self._passable.shape, dtype=np.bool_)
            flood(self._reachable, self._passable, self._blocked, *self._here)
        return self._reachable

    @property
    def radius(self) -> float:
        """Lengths below this are known; inf when all are."""
        return self._bucket / 4.0 if self._sizes.any() else math.inf

    def search(self, radius: float) -> None:
        """Make known the lengths below `radius`."""
        if self.radius < radius:
            bucket = math.ceil(min(4.0 * radius, 2.0**62))
            self._bucket, self._stacks = _grow(
                self._cost, self._passable, self._blocked, self._stacks, self._sizes, self._bucket, bucket
            )

    def known(self, row: int, col: int) -> float | None:
        """The length to a cell, inf without a path; None if the search has not got so far."""
        if (row, col) == self._here:
            return 0.0
        length = float(self._cost[row, col]) or math.inf
        return length if length < self.radius or self.radius == math.inf else None

    def to(self, row: int, col: int) -> float:
        """The length to a cell, inf without a path."""
        radius = 16.0
        while (length := self.known(row, col)) is None:
            self.search(radius)
            radius *= _STEP
        return length

    def to_all(self) -> Costs:
        """(H, W) the lengths to all cells, inf without a path."""
        self.search(math.inf)
        cost = np.where(self._cost > 0.0, self._cost, np.float32(np.inf))
        cost[self._here] = 0.0
        return cost


def geodesic_distances(passable: Bools, blocked: Bools, row: int, col: int) -> Costs:
    """(H, W) lengths, in cells, of the shortest 8-connected paths over `passable` from a cell; inf without a path."""
    return Distances(passable, blocked, row, col).to_all()


@numba.njit(cache=True, error_model="numpy")
def _grow(
    cost: Costs, passable: Bools, blocked: Bools, stacks: Stacks, sizes: Sizes, bucket: int, past: int
) -> tuple[int, Stacks]:
    """Expand the cells in the buckets before `past`; returns the bucket to go on with, and the stacks."""
    height, width = passable.shape
    queued = sizes.sum()
    while queued > 0:
        while sizes[bucket % _BUCKETS] == 0:
            bucket += 1
        if bucket >= past:
            break
        slot = bucket % _BUCKETS
        sizes[slot] -= 1
        queued -= 1
        cell = stacks[slot, sizes[slot]]
        r, c = cell // width, cell % width
        here = cost[r, c]
        if int(4.0 * here) < bucket:
            continue  # a shorter path to it has been expanded since
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                to_r, to_c = r + dr, c + dc
                if not (0 <= to_r < height and 0 <= to_c < width) or not passable[to_r, to_c]:
                    continue
                if dr != 0 and dc != 0 and (blocked[r, to_c] or blocked[to_r, c]):
                    continue
                there = np.float32(here + (_SQRT2 if dr != 0 and dc != 0 else 1.0))
                before = cost[to_r, to_c]
                if before > 0.0 and there >= before - np.float32(1e-3):
                    continue
                cost[to_r, to_c] = there
                stacks = push(stacks, sizes, int(4.0 * there) % _BUCKETS, to_r * width + to_c)
                queued += 1
    return bucket, stacks


@numba.njit(cache=True, error_model="numpy")
def may_step(blocked: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether a step to a neighbour cuts no corner of `blocked` (H, W)."""
    return bool(to_row == row or to_col == col or not (blocked[row, to_col] or blocked[to_row, col]))


@numba.njit(cache=True, error_model="numpy")
def flood(reached: Bools, passable: Bools, blocked: Bools, row: int, col: int) -> None:
    """Add to `reached` (H, W) a cell and those that paths over `passable` lead to from it, by the steps of `Distances`.

    Paths do not lead on from cells that were reached before.
    """
    height, width = passable.shape
    stack = np.empty(4096, dtype=np.int32)
    reached[row, col] = True
    stack[0], size = row * width + col, 1
    while size > 0:
        size -= 1
        r, c = stack[size] // width, stack[size] % width
        if size + 8 > len(stack):
            stack = np.concatenate((stack, np.empty_like(stack)))
        for to_r in range(max(r - 1, 0), min(r + 2, height)):
            for to_c in range(max(c - 1, 0), min(c + 2, width)):
                if reached[to_r, to_c] or not passable[to_r, to_c]:
                    continue
                if not may_step(blocked, r, c, to_r, to_c):
                    continue
                reached[to_r, to_c] = True
                stack[size] = to_r * width + to_c
                size += 1


def cell_before_gap(reachable: Bools, cost_without_clearance: Costs, row: int, col: int) -> Cell | None:
    """The last `reachable` cell on the path to a cell that only `cost_without_clearance` reaches.

    Both are (H, W); the second has distances from the robot, which lead through gaps that the clearance closes. None if
    the cell is reached by both or by neither, or if the path has no reachable cell.
    """
    if not np.isfinite(cost_without_clearance[row, col]) or reachable[row, col]:
        return None
    while not reachable[row, col]:
        top, left = max(row - 1, 0), max(col - 1, 0)
        around = cost_without_clearance[top : row + 2, left : col + 2]
        down, right = divmod(int(np.argmin(around)), around.shape[1])
        if around[down, right] >= cost_without_clearance[row, col]:
            return None
        row, col = top + down, left + right
    return row, col
