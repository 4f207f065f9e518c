"""All searches over cells: the cheapest path between two cells, and the cheapest ways from one tile to all others.

Arrays are (H, W), indexed [row = y, col = x]. Steps lead to the eight neighbours and cut no corner of a blocked cell. A
step costs its length, in cells, times the mean of what a unit of length costs in both cells.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.freespace import Bools, Floats

Cells = NDArray[np.int64]
"""(N, 2) row, col."""
Cell = tuple[int, int]
_TILES = (1 << 32) - 1  # the lower bits of a number in a queue: the tile; the upper ones: its cost


@numba.njit(cache=True, error_model="numpy")
def cheapest_path(cost: Floats, start: Cell, goal: Cell) -> tuple[Cells, float, int]:
    """The cells (N, 2) of a cheapest path over (H, W) costs, its cost, and the number of cells expanded.

    Costs are at least 1, and inf in blocked cells. Without a path: (0, 2) and inf. A* (Hart, Nilsson, Raphael 1968).
    """
    height, width = cost.shape
    # 0 where not reached: pages of memory that are never written to cost nothing.
    spent, before, is_done = np.zeros(cost.size), np.zeros(cost.size, np.int32), np.zeros(cost.size, np.bool_)
    first, last = start[0] * width + start[1], goal[0] * width + goal[1]
    queue, expanded = [(0.0, first)], 0
    while queue:
        cell = heapq.heappop(queue)[1]
        if is_done[cell]:
            continue
        is_done[cell] = True
        expanded += 1
        if cell == last:
            break
        row, col = cell // width, cell % width
        for r in range(max(row - 1, 0), min(row + 2, height)):
            for c in range(max(col - 1, 0), min(col + 2, width)):
                to = r * width + c
                if is_done[to] or cost[r, c] == np.inf or cost[row, c] == np.inf or cost[r, col] == np.inf:
                    continue
                length = math.sqrt(2.0) if r != row and c != col else 1.0
                there = spent[cell] + 0.5 * length * (cost[row, col] + cost[r, c])
                if spent[to] == 0.0 or there < spent[to]:
                    spent[to], before[to] = there, cell
                    down, across = abs(r - goal[0]), abs(c - goal[1])
                    left = max(down, across) + (math.sqrt(2.0) - 1.0) * min(down, across)
                    heapq.heappush(queue, (there + left, to))
    if not is_done[last]:
        return np.empty((0, 2), dtype=np.int64), np.inf, expanded
    count, cell = 1, last
    while cell != first:
        count, cell = count + 1, before[cell]
    cells, cell = np.empty((count, 2), dtype=np.int64), last
    for k in range(count - 1, -1, -1):
        cells[k, 0], cells[k, 1] = cell // width, cell % width
        cell = before[cell]
    return cells, spent[last], expanded


class Links(NamedTuple):
    """Tiles, squares of cells, and where passable cells of two of them meet across the edge between them."""

    right: Bools
    """(R, C) whether each tile leads to the next one of its row"""
    up: Bools
    """(R, C) whether each leads to the one in the next row"""

    @classmethod
    def of(cls, passable: Bools, side: int) -> Links:
        """Those of (H, W) passable cells in tiles of `side` cells; both sides of the map are multiples of that."""
        rows, cols = passable.shape[0] // side, passable.shape[1] // side
        right, up = np.zeros((2, rows, cols), dtype=np.bool_)
        across = passable[:, side - 1 : -1 : side] & passable[:, side::side]
        right[:, :-1] = across.reshape(rows, side, cols - 1).any(axis=1)
        above = passable[side - 1 : -1 : side] & passable[side::side]
        up[:-1] = above.reshape(rows - 1, cols, side).any(axis=2)
        return cls(right, up)


@numba.njit(cache=True, error_model="numpy")
def ways_from(links: Links, cost: Floats, start: Cell, wanted: Cells) -> tuple[Floats, NDArray[np.int32]]:
    """The costs of the cheapest ways from a tile, and the tile before each on its way; inf and -1 without one.

    `cost` (R, C) is of a unit of length. The search ends when all of the `wanted` tiles (N, 2) are reached, if there
    are any: ways that are dearer than to these are not found. Dijkstra's algorithm.
    """
    rows, cols = cost.shape
    costs, before = np.full((rows, cols), np.inf, np.float32), np.full(rows * cols, -1, np.int32)
    is_wanted, missing = np.zeros(rows * cols, np.bool_), 0
    for k in range(len(wanted)):
        tile = wanted[k, 0] * cols + wanted[k, 1]
        missing += not is_wanted[tile]
        is_wanted[tile] = True
    costs[start] = 0.0
    # Costs and tiles in one number each, whose order is theirs: the bits of floats that are not negative ascend.
    cost_bits = costs.view(np.int32)
    queue = [np.int64(start[0] * cols + start[1])]
    while queue:
        first = heapq.heappop(queue)
        tile = first & _TILES
        row, col = tile // cols, tile % cols
        if first >> 32 > cost_bits[row, col]:
            continue
        spent = costs[row, col]
        if is_wanted[tile]:
            is_wanted[tile] = False
            missing -= 1
            if missing == 0:
                break
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                length = math.sqrt(2.0) if r != row and c != col else 1.0
                there = np.float32(spent + 0.5 * length * (cost[row, col] + cost[r, c]))
                if not there < costs[r, c]:
                    continue
                low, left = min(r, row), min(c, col)
                is_way = c == col or (links.right[row, left] and links.right[r, left])
                if is_way and (r == row or (links.up[low, col] and links.up[low, c])):
                    costs[r, c] = there
                    before[r * cols + c] = tile
                    heapq.heappush(queue, (np.int64(cost_bits[r, c]) << 32) + r * cols + c)
    return costs, before
