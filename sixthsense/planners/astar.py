"""A* over the cells of a free space (report section 4.4), optimal among 8-connected paths that cut no corner."""

from __future__ import annotations

import math
import time

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.freespace import FreeSpace, as_point
from sixthsense.planners.base import Plan

SQRT2 = math.sqrt(2.0)
BUCKET = 0.25
"""Width of a bucket of the queue, in cells; one step raises f by at most 2 sqrt 2, so `BUCKETS` in a ring suffice."""
BUCKETS = 16
TIE = 1e-9
"""Costs this near are equal: sums of the same steps in another order differ by rounding alone."""
EXPANDED = np.uint8(8)
MOVES = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""(row, col) of the eight steps, straight ones first."""


class AStar:
    """Shortest path from cell centre to cell centre, joined to the exact start and goal."""

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan as `Planner` promises; the path is start, the centres of all its cells, goal."""
        began = time.perf_counter()
        start_world, goal_world = as_point("start", start), as_point("goal", goal)
        space = space.covering(start_world, goal_world)
        if space.is_blocked(start_world):
            return Plan.without_path("start blocked", 0, time.perf_counter() - began)
        if space.is_blocked(goal_world):
            return Plan.without_path("goal blocked", 0, time.perf_counter() - began)
        cells, _, expanded = _search(space.blocked, *space.cell_of(start_world), *space.cell_of(goal_world))
        if len(cells) == 0:
            return Plan.without_path("no path", expanded, time.perf_counter() - began)
        centres = np.array(space.origin) + (cells[:, ::-1] + 0.5) * space.cell_m
        # Within one cell the straight line is free.
        between = centres if len(cells) > 1 else np.empty((0, 2))
        path_world = np.concatenate([start_world[None], between, goal_world[None]])
        repeated = (np.diff(path_world, axis=0) == 0.0).all(axis=1)
        if len(path_world) > 2:  # an end that is a centre itself
            path_world = path_world[np.concatenate([[True], ~repeated])]
        return Plan.along(path_world, expanded, time.perf_counter() - began)


@numba.njit(cache=True, error_model="numpy")
def _search(
    blocked: NDArray[np.bool_], start_row: int, start_col: int, goal_row: int, goal_col: int
) -> tuple[NDArray[np.int64], float, int]:
    """The cells (N, 2) of a shortest path in (H, W) `blocked` between two free cells, its cost in cells, expansions.

    No path: (0, 2) and inf. The queue is a ring of stacks, each holding the f of one `BUCKET`: within a stack order
    is arbitrary, so a node whose cost improves after its expansion is expanded again, and the search ends only when
    no cost left in the queue is below the goal's. Pushing and popping take constant time.
    """
    height, width = blocked.shape
    stride = width + 2
    # Costs from the start: inf where not reached, -1 where blocked, so that no step improves it; a blocked border
    # saves the test of bounds.
    cost = np.full((height + 2) * stride, -1.0)
    for row in range(height):
        for col in range(width):
            if not blocked[row, col]:
                cost[(row + 1) * stride + col + 1] = np.inf
    came = np.zeros(cost.size, dtype=np.uint8)  # the step that led here, and whether it was expanded since
    stacks = np.empty((BUCKETS, 1024), dtype=np.int32)
    sizes = np.zeros(BUCKETS, dtype=np.int64)
    start, goal = (start_row + 1) * stride + start_col + 1, (goal_row + 1) * stride + goal_col + 1
    lowest = _octile(start_row - goal_row, start_col - goal_col)
    cost[start] = 0.0
    stacks[0, 0] = start
    sizes[0] = 1
    queued, bucket, expanded = 1, 0, 0
    while queued > 0:
        while sizes[bucket % BUCKETS] == 0:
            bucket += 1
        if lowest + bucket * BUCKET >= cost[goal]:
            break
        slot = bucket % BUCKETS
        sizes[slot] -= 1
        queued -= 1
        node = np.int64(stacks[slot, sizes[slot]])
        row, col = node // stride - 1, node % stride - 1
        g = cost[node]
        if came[node] & EXPANDED or g + _octile(row - goal_row, col - goal_col) > cost[goal] - TIE:
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
            f = g_to + _octile(row + d_row - goal_row, col + d_col - goal_col)
            slot = max(bucket, int((f - lowest) / BUCKET)) % BUCKETS
            if sizes[slot] == stacks.shape[1]:
                wider = np.empty((BUCKETS, 2 * stacks.shape[1]), dtype=np.int32)
                wider[:, : stacks.shape[1]] = stacks
                stacks = wider
            stacks[slot, sizes[slot]] = to
            sizes[slot] += 1
            queued += 1
    if cost[goal] == np.inf:
        return np.empty((0, 2), dtype=np.int64), np.inf, expanded
    steps = 0
    node = goal
    while node != start:
        d_row, d_col = MOVES[came[node] & 7]
        node -= d_row * stride + d_col
        steps += 1
    cells = np.empty((steps + 1, 2), dtype=np.int64)
    node = goal
    for i in range(steps, -1, -1):
        cells[i, 0], cells[i, 1] = node // stride - 1, node % stride - 1
        d_row, d_col = MOVES[came[node] & 7]
        node -= d_row * stride + d_col
    return cells, cost[goal], expanded


@numba.njit(cache=True, error_model="numpy", inline="always")
def _octile(rows: int, cols: int) -> float:
    """Length in cells of the shortest 8-connected path over so many rows and columns when nothing is in the way."""
    return max(abs(rows), abs(cols)) + (SQRT2 - 1.0) * min(abs(rows), abs(cols))
