"""A queue of cells in a ring of stacks, and an array that grows: adding and taking a cell take constant time."""

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
        wider[:, : stacks.shape[1]] = stacks
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
