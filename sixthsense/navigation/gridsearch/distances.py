"""Lengths of the shortest paths from one cell to all others, and which cells paths lead to."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.bucket_queue import Sizes, Stacks, pop, push
from sixthsense.slam.mapping.freespace import Bools

Costs = NDArray[np.float32]

_SQRT2 = math.sqrt(2.0)
_BUCKETS = 8  # each a quarter of a cell wide: a step is at most sqrt 2
_START = np.float32(1e-30)  # instead of 0; added to the length of a step it makes no difference


def geodesic_distances(passable: Bools, blocked: Bools, row: int, col: int) -> Costs:
    """(H, W) lengths, in cells, of the shortest 8-connected paths over `passable` from a cell; inf without a path.

    Diagonal steps cut no corner of `blocked` (H, W).
    """
    cost = _distances(passable, blocked, row, col)
    cost[cost == 0.0] = np.inf
    cost[row, col] = 0.0
    return np.asarray(cost)


@numba.njit(cache=True, error_model="numpy")
def _distances(passable: Bools, blocked: Bools, row: int, col: int) -> Costs:
    """Dijkstra's search with a ring of buckets; 0 where no path leads."""
    height, width = passable.shape
    cost: Costs = np.zeros((height, width), dtype=np.float32)
    cost[row, col] = _START
    stacks: Stacks = np.empty((_BUCKETS, 1024), dtype=np.int32)
    sizes: Sizes = np.zeros(_BUCKETS, dtype=np.int64)
    stacks[0, 0], sizes[0] = row * width + col, 1
    bucket, queued = 0, 1
    while queued > 0:
        bucket, cell = pop(stacks, sizes, bucket)
        queued -= 1
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
    return cost


def reached_cells(passable: Bools, blocked: Bools, row: int, col: int) -> Bools:
    """(H, W) a cell and those that paths over `passable` lead to from it; diagonal steps cut no corner of `blocked`."""
    reached = np.zeros(passable.shape, dtype=np.bool_)
    _flood(reached, passable, blocked, row, col)
    return reached


@numba.njit(cache=True, error_model="numpy")
def may_step(blocked: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether a step to a neighbour cuts no corner of `blocked` (H, W)."""
    return bool(to_row == row or to_col == col or not (blocked[row, to_col] or blocked[to_row, col]))


@numba.njit(cache=True, error_model="numpy")
def _flood(reached: Bools, passable: Bools, blocked: Bools, row: int, col: int) -> None:
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
