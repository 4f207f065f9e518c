"""The tree of shortest paths to one goal, grown as far as a start asks for, and repaired where the map has changed.

A* (Hart, Nilsson, Raphael 1968) from the goal, among 8-connected paths that cut no corner. What it finds stays: when
cells become blocked, the branches through them are cut off and the cells around these put back into the queue, as in
D* Extra Lite (Przybylski and Putz, Int. J. Appl. Math. Comput. Sci. 27(2), 2017); when cells become free, so are the
cells around them. The next search goes on from there. Costs are those of a search from scratch.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import Bools

SQRT2 = math.sqrt(2.0)
BUCKET = 0.25
"""Width of a bucket of the queue, in cells; one step raises f by at most 2 sqrt 2, so `BUCKETS` in a ring suffice."""
BUCKETS = 16
TIE = 1e-9
"""Costs this near are equal: sums of the same steps in another order differ by rounding alone."""
STEP, EXPANDED, LISTED = np.uint8(7), np.uint8(8), np.uint8(16)
"""Bits of what is known of a cell: the step that led there, whether it was expanded since, a mark while listing."""
MOVES = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""(row, col) of the eight steps, straight ones first."""

Nodes = NDArray[np.int32]
Marks = NDArray[np.uint8]


def search(blocked: Bools, start: tuple[int, int], goal: tuple[int, int]) -> tuple[NDArray[np.int64], float, int]:
    """The cells (N, 2) of a shortest path in (H, W) `blocked` between two free cells, its cost in cells, expansions.

    No path: (0, 2) and inf.
    """
    tree = CostTree(blocked, goal)
    cost, expanded = tree.reach(start)
    return tree.path(start) if cost < np.inf else np.empty((0, 2), dtype=np.int64), cost, expanded


class CostTree:
    """Costs to one goal cell, in cells, of all cells that starts have asked for so far, and the steps that lead there.

    The cells are those of `blocked` with a border of blocked ones, flat, which saves the test of bounds.
    """

    def __init__(self, blocked: Bools, goal: tuple[int, int]) -> None:
        """Begin at `goal` (row, col), a free cell of (H, W) `blocked`."""
        self.blocked = blocked
        self.goal = goal
        self._stride = blocked.shape[1] + 2
        self._root = self._node(goal)
        # inf where not reached, -1 where blocked, so that no step improves it.
        self._cost = np.full((blocked.shape[0] + 2, self._stride), -1.0)
        self._cost[1:-1, 1:-1] = np.where(blocked, -1.0, np.inf)
        self._cost = self._cost.ravel()
        self._cost[self._root] = 0.0
        self._came = np.zeros(self._cost.size, dtype=np.uint8)
        self._waiting = np.array([self._root], dtype=np.int32)

    def change(self, blocked: Bools, at_most: int) -> bool:
        """Take in another state of the same cells, (H, W), the goal still free; not if more than `at_most` changed."""
        changed = np.flatnonzero(blocked != self.blocked)
        if len(changed) > at_most:
            return False
        rows, cols = np.divmod(changed, blocked.shape[1])
        nodes = ((rows + 1) * self._stride + cols + 1).astype(np.int32)
        closed = blocked.ravel()[changed]
        reopened = _change(self._cost, self._came, self._stride, self._root, nodes[closed], nodes[~closed])
        self._waiting = np.concatenate([self._waiting, reopened])
        self.blocked = blocked
        return True

    def reach(self, start: tuple[int, int]) -> tuple[float, int]:
        """Cost in cells from `start` (row, col), a free cell, inf without a path; and the cells expanded for it."""
        node = self._node(start)
        expanded, self._waiting = _reach(self._cost, self._came, self._stride, self._waiting, node)
        return float(self._cost[node]), expanded

    def path(self, start: tuple[int, int]) -> NDArray[np.int64]:
        """The cells (N, 2) of a shortest path from `start`, which `reach` has reached, to the goal, both included."""
        return _walk(self._came, self._stride, self._node(start), self._root)

    def _node(self, cell: tuple[int, int]) -> int:
        return int((cell[0] + 1) * self._stride + cell[1] + 1)


@numba.njit(cache=True, error_model="numpy")
def _reach(cost: Array, came: Marks, stride: int, waiting: Nodes, target: int) -> tuple[int, Nodes]:
    """Expand the cells of `waiting`, and those they lead to, until none is left by which `target` could cost less.

    `cost` and `came` are updated. Returns the number of expansions, and the cells that wait for the next search. The
    queue is a ring of stacks, each holding the f of one `BUCKET`: within a stack order is arbitrary, so a cell whose
    cost improves after its expansion is expanded again. Pushing and popping take constant time.
    """
    target_row, target_col = target // stride, target % stride
    seeds = np.empty(len(waiting), dtype=np.int32)
    f_seeds = np.empty(len(waiting))
    count = 0
    for i in range(len(waiting)):
        node = int(waiting[i])
        if 0.0 <= cost[node] < np.inf and not came[node] & EXPANDED:
            seeds[count] = node
            f_seeds[count] = cost[node] + _octile(node // stride - target_row, node % stride - target_col)
            count += 1
    order = np.argsort(f_seeds[:count])
    lowest = f_seeds[order[0]] if count > 0 else 0.0
    stacks = np.empty((BUCKETS, 1024), dtype=np.int32)
    sizes = np.zeros(BUCKETS, dtype=np.int64)
    left = np.empty(1024, dtype=np.int32)
    taken, queued, kept, bucket, expanded = 0, 0, 0, 0, 0
    while queued > 0 or taken < count:
        if queued == 0:
            bucket = max(bucket, int((f_seeds[order[taken]] - lowest) / BUCKET))
        if lowest + bucket * BUCKET >= cost[target]:
            break
        slot = bucket % BUCKETS
        while taken < count and f_seeds[order[taken]] < lowest + (bucket + 1) * BUCKET:
            if sizes[slot] == stacks.shape[1]:
                stacks = _wider(stacks)
            stacks[slot, sizes[slot]] = seeds[order[taken]]
            sizes[slot] += 1
            queued += 1
            taken += 1
        if sizes[slot] == 0:
            bucket += 1
            continue
        sizes[slot] -= 1
        queued -= 1
        node = int(stacks[slot, sizes[slot]])
        if came[node] & EXPANDED:
            continue
        row, col = node // stride, node % stride
        g = cost[node]
        if g + _octile(row - target_row, col - target_col) > cost[target] - TIE:
            if kept == len(left):
                left = np.concatenate((left, np.empty_like(left)))
            left[kept] = node
            kept += 1
            continue
        came[node] |= EXPANDED
        expanded += 1
        for k in range(8):
            d_row, d_col = MOVES[k]
            to = node + d_row * stride + d_col
            g_to = g + (1.0 if k < 4 else SQRT2)
            if g_to > cost[to] - TIE:
                continue
            if k >= 4 and (cost[node + d_row * stride] < 0.0 or cost[node + d_col] < 0.0):
                continue
            cost[to] = g_to
            came[to] = k
            f = g_to + _octile(row + d_row - target_row, col + d_col - target_col)
            slot = max(bucket, int((f - lowest) / BUCKET)) % BUCKETS
            if sizes[slot] == stacks.shape[1]:
                stacks = _wider(stacks)
            stacks[slot, sizes[slot]] = to
            sizes[slot] += 1
            queued += 1
    # A cell is in the queue once for each improvement; one entry is enough to begin with next time.
    found = np.empty(kept + queued + count - taken, dtype=np.int32)
    found[:kept] = left[:kept]
    for slot in range(BUCKETS):
        found[kept : kept + sizes[slot]] = stacks[slot, : sizes[slot]]
        kept += sizes[slot]
    for i in range(taken, count):
        found[kept] = seeds[order[i]]
        kept += 1
    listed = 0
    for i in range(len(found)):
        if not came[found[i]] & (EXPANDED | LISTED):
            came[found[i]] |= LISTED
            found[listed] = found[i]
            listed += 1
    for i in range(listed):
        came[found[i]] &= ~LISTED
    return expanded, found[:listed].copy()


@numba.njit(cache=True, error_model="numpy")
def _change(cost: Array, came: Marks, stride: int, root: int, closed: Nodes, opened: Nodes) -> Nodes:
    """Block the cells `closed` and free the cells `opened`; returns the cells to be expanded anew.

    Every cell whose way to `root` leads through a blocked one, or diagonally past its corner, is as if never reached.
    """
    lost = np.empty(1024, dtype=np.int32)
    count = 0
    for node in closed:
        lost, count = _lose(cost, came, lost, count, node)
        for k in range(4, 8):
            d_row, d_col = MOVES[k]
            for to in (node + d_col, node + d_row * stride):  # the ends of the two such steps that pass the cell
                if came[to] & STEP == k and to != root:
                    lost, count = _lose(cost, came, lost, count, to)
    i = 0
    while i < count:
        for k in range(8):
            to = lost[i] + MOVES[k][0] * stride + MOVES[k][1]
            if came[to] & STEP == k and to != root:
                lost, count = _lose(cost, came, lost, count, to)
        i += 1
    for node in closed:
        cost[node] = -1.0
    for node in opened:
        cost[node] = np.inf
    reopened = np.empty(1024, dtype=np.int32)
    size = 0
    for node in np.concatenate((lost[:count], opened)):
        for k in range(8):
            beside = node + MOVES[k][0] * stride + MOVES[k][1]
            if came[beside] & EXPANDED:
                came[beside] &= ~EXPANDED
                if size == len(reopened):
                    reopened = np.concatenate((reopened, np.empty_like(reopened)))
                reopened[size] = beside
                size += 1
    return reopened[:size].copy()


@numba.njit(cache=True, error_model="numpy")
def _lose(cost: Array, came: Marks, lost: Nodes, count: int, node: int) -> tuple[Nodes, int]:
    """Append `node` to the first `count` of `lost` and forget what is known of it, if it has a cost."""
    if not 0.0 <= cost[node] < np.inf:
        return lost, count
    if count == len(lost):
        lost = np.concatenate((lost, np.empty_like(lost)))
    lost[count] = node
    cost[node] = np.inf
    came[node] = 0
    return lost, count + 1


@numba.njit(cache=True, error_model="numpy")
def _walk(came: Marks, stride: int, start: int, root: int) -> NDArray[np.int64]:
    """The cells (N, 2), row and col without the border, from `start` along the steps back to `root`."""
    steps, node = 0, start
    while node != root:
        d_row, d_col = MOVES[came[node] & STEP]
        node -= d_row * stride + d_col
        steps += 1
    cells = np.empty((steps + 1, 2), dtype=np.int64)
    node = start
    for i in range(steps + 1):
        cells[i, 0], cells[i, 1] = node // stride - 1, node % stride - 1
        d_row, d_col = MOVES[came[node] & STEP]
        node -= d_row * stride + d_col
    return cells


@numba.njit(cache=True, error_model="numpy")
def _wider(stacks: NDArray[np.int32]) -> NDArray[np.int32]:
    """The stacks with room for twice as many."""
    wider = np.empty((stacks.shape[0], 2 * stacks.shape[1]), dtype=np.int32)
    wider[:, : stacks.shape[1]] = stacks
    return wider


@numba.njit(cache=True, error_model="numpy", inline="always")
def _octile(rows: int, cols: int) -> float:
    """Length in cells of the shortest 8-connected path over so many rows and columns when nothing is in the way."""
    return max(abs(rows), abs(cols)) + (SQRT2 - 1.0) * min(abs(rows), abs(cols))
