"""Lengths of the shortest paths from one cell to all others."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.bucket_queue import push
from sixthsense.slam.mapping.freespace import Bools

Costs = NDArray[np.float32]

_SQRT2 = math.sqrt(2.0)
_BUCKETS = 8  # each a quarter of a cell wide: a step is at most sqrt 2


@numba.njit(cache=True, error_model="numpy")
def geodesic_distances(passable: Bools, blocked: Bools, row: int, col: int) -> Costs:
    """(H, W) lengths, in cells, of the shortest 8-connected paths over `passable` from a cell; inf without a path.

    Dijkstra's search with a ring of buckets. A cell that improves after its expansion is expanded again.
    """
    height, width = passable.shape
    cost = np.full((height, width), np.float32(np.inf))
    stacks = np.empty((_BUCKETS, 1024), dtype=np.int32)
    sizes = np.zeros(_BUCKETS, dtype=np.int64)
    cost[row, col] = 0.0
    stacks[0, 0] = row * width + col
    sizes[0] = 1
    queued, bucket = 1, 0
    while queued > 0:
        while sizes[bucket % _BUCKETS] == 0:
            bucket += 1
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
                if there >= cost[to_r, to_c] - np.float32(1e-3):
                    continue
                cost[to_r, to_c] = there
                stacks = push(stacks, sizes, int(4.0 * there) % _BUCKETS, to_r * width + to_c)
                queued += 1
    return cost


def cell_before_gap(cost: Costs, cost_without_clearance: Costs, row: int, col: int) -> tuple[int, int] | None:
    """The last cell with finite `cost` on the path to a cell that only `cost_without_clearance` reaches.

    Both are (H, W) distances from the robot; the second leads through gaps that the clearance closes. None if the cell
    is reached by both or by neither, or if the path has no cell with finite `cost`.
    """
    if not np.isfinite(cost_without_clearance[row, col]) or np.isfinite(cost[row, col]):
        return None
    while not np.isfinite(cost[row, col]):
        top, left = max(row - 1, 0), max(col - 1, 0)
        around = cost_without_clearance[top : row + 2, left : col + 2]
        down, right = divmod(int(np.argmin(around)), around.shape[1])
        if around[down, right] >= cost_without_clearance[row, col]:
            return None
        row, col = top + down, left + right
    return row, col
