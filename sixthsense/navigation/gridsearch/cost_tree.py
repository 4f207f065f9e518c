"""The tree of shortest paths to one goal: grown as far as a start needs, and repaired when the map changes.

A* (Hart, Nilsson, Raphael 1968) from the goal, among 8-connected paths that cut no corner. The tree is kept between
searches. When cells become blocked, the branches through them are removed and the cells around those are queued again,
as in D* Extra Lite (Przybylski and Putz, Int. J. Appl. Math. Comput. Sci. 27(2), 2017). When cells become free, the
cells around them are queued. The next search continues from there. Its costs are those of a search from scratch.
"""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.ordering import ascending
from sixthsense.navigation.gridsearch.prices import Sizes, Stacks, appended, push
from sixthsense.slam.mapping.freespace import TOUCH, Bools

Nodes = NDArray[np.int32]
"""Flat indices of cells, a border of blocked cells included."""
Steps = NDArray[np.uint8]
"""Per cell: the step that led to it, an index into `MOVES`, and the flags `EXPANDED`, `LISTED` and `BLOCKED`."""

BUCKET = 0.25
"""Width of a bucket of the queue, in cells."""
BUCKETS = math.ceil(2.0 * math.sqrt(2.0) / BUCKET) + 1
"""Buckets in the ring: one step raises f by at most 2 sqrt 2."""
STEP, EXPANDED, LISTED, BLOCKED = np.uint8(7), np.uint8(8), np.uint8(16), np.uint8(32)
ROOT = np.finfo(np.float64).tiny
"""Cost of the goal, instead of 0; added to the length of a step it makes no difference."""
MOVES = tuple(sorted(itertools.product((0, 1, -1), repeat=2), key=lambda move: abs(move[0]) + abs(move[1])))[1:]
"""(row, col) of the eight steps, straight ones first."""


def shortest_path(
    blocked: Bools, start: tuple[int, int], goal: tuple[int, int]
) -> tuple[NDArray[np.int64], float, int]:
    """The cells (N, 2) of a shortest path in (H, W) `blocked` between two free cells, its cost in cells, expansions.

    Without a path: (0, 2) and inf.
    """
    tree = CostTree(blocked, goal)
    cost, expanded = tree.reach(start)
    return tree.path(start) if cost < np.inf else np.empty((0, 2), dtype=np.int64), cost, expanded


class CostTree:
    """Costs to one goal cell, in cells, of the cells that the searches so far have needed, and the steps to it.

    The arrays are flat and have a border of blocked cells, which saves the test of bounds.
    """

    def __init__(self, blocked: Bools, goal: tuple[int, int]) -> None:
        """Begin at `goal` (row, col), a free cell of (H, W) `blocked`."""
        self.blocked = blocked
        self.goal = goal
        self._stride = blocked.shape[1] + 2
        self._root = self._node(goal)
        steps = np.full((blocked.shape[0] + 2, self._stride), BLOCKED)
        np.multiply(blocked, BLOCKED, out=steps[1:-1, 1:-1])
        self._steps = steps.ravel()
        # 0 where not reached: pages of memory that are never written to cost nothing.
        self._cost = np.zeros(self._steps.size)
        self._cost[self._root] = ROOT
        self._waiting = np.array([self._root], dtype=np.int32)

    def update(self, blocked: Bools) -> None:
        """Repair the tree for another state (H, W) of the same cells, with the goal still free."""
        changed = np.flatnonzero(blocked != self.blocked)
        rows, cols = np.divmod(changed, blocked.shape[1])
        nodes = ((rows + 1) * self._stride + cols + 1).astype(np.int32)
        closed = blocked.ravel()[changed]
        reopened = _repair(self._cost, self._steps, self._stride, self._root, nodes[closed], nodes[~closed])
        self._waiting = np.concatenate([self._waiting, reopened])
        self.blocked = blocked

    def reach(self, start: tuple[int, int]) -> tuple[float, int]:
        """Cost in cells from `start` (row, col), a free cell, inf without a path; and the cells expanded for it."""
        node = self._node(start)
        expanded, self._waiting = _grow(self._cost, self._steps, self._stride, self._waiting, node)
        cost = 0.0 if node == self._root else float(self._cost[node]) or math.inf
        return cost, expanded

    def path(self, start: tuple[int, int]) -> NDArray[np.int64]:
        """The cells (N, 2) of a shortest path from `start`, which `reach` has reached, to the goal, both included."""
        return _trace_path(self._steps, self._stride, self._node(start), self._root)

    def _node(self, cell: tuple[int, int]) -> int:
        return int((cell[0] + 1) * self._stride + cell[1] + 1)


@numba.njit(cache=True, error_model="numpy")
def _grow(cost: Array, steps: Steps, stride: int, waiting: Nodes, target: int) -> tuple[int, Nodes]:
    """Expand `waiting` and the cells they lead to until no cell is left by which `target` could cost less.

    `cost` (0: not reached) and `steps` are flat, with a border of blocked cells, and are updated.
    Returns the number of expansions and the cells that wait for the next search. Each stack of the queue holds one
    bucket of f. The order within a stack is arbitrary, so a cell that improves after its expansion is expanded again.
    Costs that differ by less than `TOUCH` are equal: sums of the same steps in another order differ by rounding alone.
    """
    target_row, target_col = target // stride, target % stride
    seeds, f_seeds = _sorted_seeds(cost, steps, stride, waiting, target)
    count = len(seeds)
    lowest = f_seeds[0] if count > 0 else 0.0
    stacks = np.empty((BUCKETS, 1024), dtype=np.int32)
    sizes = np.zeros(BUCKETS, dtype=np.int64)
    left = np.empty(1024, dtype=np.int32)
    taken, queued, kept, bucket, expanded = 0, 0, 0, 0, 0
    while queued > 0 or taken < count:
        if queued == 0:
            bucket = max(bucket, int((f_seeds[taken] - lowest) / BUCKET))
        so_far = cost[target] if cost[target] > 0.0 else np.inf
        if lowest + bucket * BUCKET >= so_far:
            break
        slot = bucket % BUCKETS
        while taken < count and f_seeds[taken] < lowest + (bucket + 1) * BUCKET:
            stacks = push(stacks, sizes, slot, seeds[taken])
            queued += 1
            taken += 1
        if sizes[slot] == 0:
            bucket += 1
            continue
        sizes[slot] -= 1
        queued -= 1
        node = int(stacks[slot, sizes[slot]])
        if steps[node] & EXPANDED:
            continue
        row, col = node // stride, node % stride
        g = cost[node]
        if g + _octile(row - target_row, col - target_col) > so_far - TOUCH:
            left, kept = appended(left, kept, node)
            continue
        steps[node] |= EXPANDED
        expanded += 1
        for k in range(8):
            d_row, d_col = MOVES[k]
            to = node + d_row * stride + d_col
            g_to = g + _octile(d_row, d_col)
            if steps[to] & BLOCKED or (cost[to] > 0.0 and g_to > cost[to] - TOUCH):
                continue
            if k >= 4 and (steps[node + d_row * stride] | steps[node + d_col]) & BLOCKED:
                continue
            cost[to] = g_to
            steps[to] = k
            f = g_to + _octile(row + d_row - target_row, col + d_col - target_col)
            stacks = push(stacks, sizes, max(bucket, int((f - lowest) / BUCKET)) % BUCKETS, to)
            queued += 1
    return expanded, _cells_to_resume(steps, left[:kept], stacks, sizes, seeds[taken:])


@numba.njit(cache=True, error_model="numpy")
def _sorted_seeds(cost: Array, steps: Steps, stride: int, waiting: Nodes, target: int) -> tuple[Nodes, Array]:
    """The cells of `waiting` that are reached and not expanded, by increasing f, and their f."""
    seeds, f_seeds = np.empty(len(waiting), dtype=np.int32), np.empty(len(waiting))
    count = 0
    for i in range(len(waiting)):
        node = int(waiting[i])
        if cost[node] > 0.0 and not steps[node] & EXPANDED:
            seeds[count] = node
            f_seeds[count] = cost[node] + _octile(node // stride - target // stride, node % stride - target % stride)
            count += 1
    order = ascending(f_seeds[:count])
    return seeds[order], f_seeds[order]


@numba.njit(cache=True, error_model="numpy")
def _cells_to_resume(steps: Steps, left: Nodes, stacks: Stacks, sizes: Sizes, seeds: Nodes) -> Nodes:
    """The cells from which the next search goes on, each once though it may be queued once per improvement."""
    found = np.empty(len(left) + sizes.sum() + len(seeds), dtype=np.int32)
    for i in range(len(left)):
        found[i] = left[i]
    count = len(left)
    for slot in range(len(sizes)):
        for i in range(sizes[slot]):
            found[count + i] = stacks[slot, i]
        count += sizes[slot]
    for i in range(len(seeds)):
        found[count + i] = seeds[i]
    listed = 0
    for i in range(len(found)):
        if not steps[found[i]] & (EXPANDED | LISTED):
            steps[found[i]] |= LISTED
            found[listed] = found[i]
            listed += 1
    for i in range(listed):
        steps[found[i]] &= ~LISTED
    return found[:listed].copy()


@numba.njit(cache=True, error_model="numpy")
def _repair(cost: Array, steps: Steps, stride: int, root: int, closed: Nodes, opened: Nodes) -> Nodes:
    """Block the cells `closed` and free the cells `opened`; returns the cells to expand again.

    Every cell whose path to `root` leads through a blocked cell, or diagonally past its corner, becomes unreached.
    """
    removed = np.empty(1024, dtype=np.int32)
    count = 0
    for node in closed:
        removed, count = _remove(cost, steps, removed, count, node)
        for k in range(4, 8):
            d_row, d_col = MOVES[k]
            for to in (node + d_col, node + d_row * stride):  # the ends of the two diagonal steps past the cell
                if steps[to] & STEP == k and to != root:
                    removed, count = _remove(cost, steps, removed, count, to)
    i = 0
    while i < count:
        for k in range(8):
            to = removed[i] + MOVES[k][0] * stride + MOVES[k][1]
            if steps[to] & STEP == k and to != root:
                removed, count = _remove(cost, steps, removed, count, to)
        i += 1
    for node in closed:
        steps[node] |= BLOCKED
    for node in opened:
        steps[node] = 0
    reopened = np.empty(1024, dtype=np.int32)
    size = 0
    for node in np.concatenate((removed[:count], opened)):
        for k in range(8):
            beside = node + MOVES[k][0] * stride + MOVES[k][1]
            if steps[beside] & EXPANDED:
                steps[beside] &= ~EXPANDED
                reopened, size = appended(reopened, size, beside)
    return reopened[:size].copy()


@numba.njit(cache=True, error_model="numpy")
def _remove(cost: Array, steps: Steps, removed: Nodes, count: int, node: int) -> tuple[Nodes, int]:
    """Make `node` unreached and append it to the first `count` of `removed`, if it was reached."""
    if cost[node] == 0.0:
        return removed, count
    cost[node] = 0.0
    steps[node] = 0
    return appended(removed, count, node)


@numba.njit(cache=True, error_model="numpy")
def _trace_path(steps: Steps, stride: int, start: int, root: int) -> NDArray[np.int64]:
    """The cells (N, 2), row and col without the border, from `start` back along the steps to `root`."""
    length, node = 0, start
    while node != root:
        d_row, d_col = MOVES[steps[node] & STEP]
        node -= d_row * stride + d_col
        length += 1
    cells = np.empty((length + 1, 2), dtype=np.int64)
    node = start
    for i in range(length + 1):
        cells[i, 0], cells[i, 1] = node // stride - 1, node % stride - 1
        d_row, d_col = MOVES[steps[node] & STEP]
        node -= d_row * stride + d_col
    return cells


@numba.njit(cache=True, error_model="numpy", inline="always")
def _octile(rows: int, cols: int) -> float:
    """Length in cells of the shortest 8-connected path over so many rows and columns, without obstacles."""
    return max(abs(rows), abs(cols)) + (math.sqrt(2.0) - 1.0) * min(abs(rows), abs(cols))
