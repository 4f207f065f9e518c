"""The cheapest ways over cells with prices, from one cell to all others, and the queue of cells that searches share.

The queue is a ring of stacks: adding and taking a cell take constant time.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Stacks = NDArray[np.int32]
"""(B, M) the cells in the queue, one row per bucket."""
Sizes = NDArray[np.int64]
"""(B,) how many there are in each."""


@numba.njit(cache=True, error_model="numpy")
def push(stacks: Stacks, sizes: Sizes, slot: int, node: int) -> Stacks:
    """Push `node` on a stack; returns the stacks, with twice the room if that one was full."""
    if sizes[slot] == stacks.shape[1]:
        wider = np.empty((stacks.shape[0], 2 * stacks.shape[1]), dtype=np.int32)
        for row in range(stacks.shape[0]):
            for k in range(stacks.shape[1]):
                wider[row, k] = stacks[row, k]
        stacks = wider
    stacks[slot, sizes[slot]] = node
    sizes[slot] += 1
    return stacks


@numba.njit(cache=True, error_model="numpy")
def pop(stacks: Stacks, sizes: Sizes, at: int) -> tuple[int, int]:
    """Take the cheapest node of a queue that is not empty; its cost, from `at` on, and the node.

    The stacks are a ring: a node of some cost is in the stack of that number modulo the number of stacks.
    """
    while sizes[at % len(sizes)] == 0:
        at += 1
    slot = at % len(sizes)
    sizes[slot] -= 1
    return at, int(stacks[slot, sizes[slot]])


@numba.njit(cache=True, error_model="numpy")
def appended(cells: NDArray[np.signedinteger[Any]], count: int, cell: int) -> tuple[Any, int]:
    """Append `cell` to the first `count` of `cells`, in an array twice as long if that one is full; array and count."""
    if count == len(cells):
        cells = np.concatenate((cells, np.empty_like(cells)))
    cells[count] = cell
    return cells, count + 1


STRAIGHT, DIAGONAL = 5, 7
"""cost of a step into a cell of price 1; 7 / 5 is nearly the root of 2"""

Prices = NDArray[np.uint8]
"""(H, W) how much dearer a cell is than a free one, whose price is 1; 0: no way."""
Costs = NDArray[np.int32]
"""(H, W) of the cheapest way to each cell; -1 without one."""


@numba.njit(cache=True, error_model="numpy")
def costs_from(prices: Prices, row: int, col: int) -> Costs:
    """The costs of the ways from a cell.

    Steps lead to the eight neighbours, cut no corner of a cell without price, and pay for the corners of dear ones.
    """
    height, width = prices.shape
    costs = np.full((height, width), -1, dtype=np.int32)
    costs[row, col] = 0
    ring = DIAGONAL * int(prices.max()) + 1  # more than the cost of the longest step
    stacks, sizes = np.empty((ring, 1024), dtype=np.int32), np.zeros(ring, dtype=np.int64)
    stacks[0, 0], sizes[0] = row * width + col, 1
    at, queued = 0, 1
    while queued > 0:
        at, cell = pop(stacks, sizes, at)
        queued -= 1
        r, c = cell // width, cell % width
        if costs[r, c] != at:
            continue  # a cheaper way to it has been found since
        for to_r in range(max(r - 1, 0), min(r + 2, height)):
            for to_c in range(max(c - 1, 0), min(c + 2, width)):
                step = _step(prices, r, c, to_r, to_c)
                if step > 0 and (costs[to_r, to_c] < 0 or costs[to_r, to_c] > at + step):
                    costs[to_r, to_c] = at + step
                    stacks = push(stacks, sizes, (at + step) % ring, to_r * width + to_c)
                    queued += 1
    return costs


@numba.njit(cache=True, error_model="numpy")
def cheapest_way(prices: Prices, costs: Costs, row: int, col: int) -> NDArray[np.int64]:
    """The cells (N, 2) of the way to a cell that costs what `costs_from` has found; none without a way."""
    height, width = prices.shape
    way = [(row, col)]
    while costs[row, col] > 0:
        here = row, col
        for r in range(max(here[0] - 1, 0), min(here[0] + 2, height)):
            for c in range(max(here[1] - 1, 0), min(here[1] + 2, width)):
                step = _step(prices, r, c, here[0], here[1])
                if costs[r, c] >= 0 and step > 0 and costs[r, c] + step == costs[here]:
                    row, col = r, c
        way.append((row, col))
    count = len(way) if costs[row, col] == 0 else 0
    cells = np.empty((count, 2), dtype=np.int64)
    for k in range(count):
        cells[k, 0], cells[k, 1] = way[count - 1 - k]
    return cells


@numba.njit(cache=True, error_model="numpy")
def _step(prices: Prices, row: int, col: int, to_row: int, to_col: int) -> int:
    """Cost of a step between neighbours; 0 if it leads nowhere."""
    if to_row == row and to_col == col:
        return 0
    if to_row == row or to_col == col:
        return STRAIGHT * int(prices[to_row, to_col])
    a, b, to = int(prices[row, to_col]), int(prices[to_row, col]), int(prices[to_row, to_col])
    return DIAGONAL * max(a, b, to) if min(a, b, to) > 0 else 0
