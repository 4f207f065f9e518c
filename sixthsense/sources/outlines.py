"""Outlines of the occupied cells of a map, and polygons with fewer corners that stay within half a cell of them."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array

# Largest distance of a corner of the cells' outline from the simplified outline.
_TOLERANCE_CELLS = 0.5
# The cost of a segment is 1 plus this times the squared distances, in cells, of the outline's corners from it. Above 2,
# so that removing the end of a wall one cell thick (two corners half a cell off, one segment less) raises the cost.
# Below 4, so that one line replaces a staircase (two corners half a cell off for every two segments).
_DEVIATION_COST = 3.0
# Bounds the time on huge maps; few segments span more than some hundred corners.
_LOOK_AHEAD = 2000


def outline_corners(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The closed outlines of the occupied cells, the image's border included.

    `occupied` (H, W), row 0 at the bottom. Returns the corners (K, 2) of all outlines in sequence, x and y in cells
    from the lower left corner of the grid, and the end index of each outline. Occupied cells are on the left:
    counter-clockwise around a solid, clockwise around a hole. Cells that touch diagonally are connected, so that no
    ray passes between them.
    """
    corners, ends = _trace(np.pad(np.asarray(occupied, dtype=np.uint8), 1))
    return corners, ends


@numba.njit(cache=True, error_model="numpy")
def simplified(corners: Array, ends: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Closed outlines of cells with fewer corners: these in sequence, and the end index of each outline.

    The result has the least cost among all polygons through corners and midpoints of an outline's sides that stay
    within half a cell of every corner. The cost is the number of segments plus the weighted squared distances of the
    corners. Midpoints are candidates because a slanted wall is a staircase whose line passes through the midpoints of
    its steps. The shortest path over candidate points and the wedge test of a segment follow Imai and Iri, "Polygonal
    approximations of a curve" (1988).
    """
    kept = np.empty_like(corners)
    kept_ends = np.empty_like(ends)
    begin, filled = 0, 0
    for k in range(len(ends)):
        n = ends[k] - begin
        points = np.empty((2 * n + 1, 2))
        for i in range(n):
            here, ahead = corners[begin + i], corners[begin + (i + 1) % n]
            points[2 * i] = here
            points[2 * i + 1] = (here + ahead) / 2
        points[2 * n] = points[0]
        for i in _cheapest(points, _TOLERANCE_CELLS, _DEVIATION_COST):
            kept[filled] = points[i]
            filled += 1
        begin, kept_ends[k] = ends[k], filled
    return kept[:filled], kept_ends


@numba.njit(cache=True, error_model="numpy")
def _trace(cells: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Corners (K, 2) of all outlines in sequence, and the end index of each; `cells` has a free border."""
    rows, columns = cells.shape
    count = 0
    for y in range(1, rows):
        for x in range(1, columns):
            a, b, c, d = cells[y - 1, x - 1], cells[y - 1, x], cells[y, x - 1], cells[y, x]
            total = a + b + c + d
            if total == 1 or total == 3:
                count += 1
            elif total == 2 and a == d:
                count += 2
    corners = np.empty((count, 2), np.int32)
    ends = np.empty(count // 4 + 1, np.int64)
    seen = np.zeros(cells.shape, np.uint8)
    filled, loops = 0, 0
    for y0 in range(1, rows - 1):
        for x0 in range(1, columns - 1):
            # Every outline has a side that runs right, below an occupied cell. Row by row, the first cell of an
            # outline is at the left end of such a side, which is a corner.
            if cells[y0, x0] == 0 or cells[y0 - 1, x0] != 0 or seen[y0, x0] != 0:
                continue
            y, x, dy, dx = y0, x0, 0, 1
            corners[filled, 0], corners[filled, 1] = x - 1, y - 1
            filled += 1
            while True:
                if dx == 1:
                    seen[y, x] = 1
                y, x = y + dy, x + dx
                turn_y, turn_x = dy, dx
                if cells[y + (dy - dx - 1) // 2, x + (dx + dy - 1) // 2] != 0:  # ahead on the right
                    turn_y, turn_x = -dx, dy
                elif cells[y + (dy + dx - 1) // 2, x + (dx - dy - 1) // 2] == 0:  # ahead on the left
                    turn_y, turn_x = dx, -dy
                if turn_x == dx:
                    continue
                dy, dx = turn_y, turn_x
                if y == y0 and x == x0 and dx == 1:
                    break
                corners[filled, 0], corners[filled, 1] = x - 1, y - 1
                filled += 1
            ends[loops] = filled
            loops += 1
    return corners, ends[:loops]


@numba.njit(cache=True, error_model="numpy")
def _cheapest(points: Array, tolerance: float, deviation_cost: float) -> NDArray[np.int64]:
    """Indices of the kept points of a closed outline (N + 1, 2): even ones are corners, the last point is the first."""
    n = points.shape[0] - 1
    cost = np.full(n + 1, np.inf)
    cost[0] = 0.0
    previous = np.zeros(n + 1, np.int64)
    for i in range(n):
        # The wedge of directions, relative to the first one, that pass all corners so far within the tolerance.
        wedge, first, low, high = False, 0.0, -math.pi, math.pi
        far_sq, xx, xy, yy = 0.0, 0.0, 0.0, 0.0
        for j in range(i + 1, min(n, i + _LOOK_AHEAD) + 1):
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            distance_sq = dx * dx + dy * dy
            angle = math.atan2(dy, dx)
            turn = (angle - first + math.pi) % (2 * math.pi) - math.pi
            # The wedge constrains the infinite line, so no corner may lie beyond the end of the segment.
            if distance_sq >= far_sq and (not wedge or (turn >= low - 1e-9 and turn <= high + 1e-9)):
                deviation_sq = (xx * dy * dy - 2 * xy * dx * dy + yy * dx * dx) / distance_sq
                total = cost[i] + 1.0 + deviation_cost * deviation_sq
                if total < cost[j]:
                    cost[j], previous[j] = total, i
            if j % 2 == 1:
                continue
            far_sq = max(far_sq, distance_sq)
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            if distance_sq > tolerance * tolerance:
                half = math.asin(tolerance / math.sqrt(distance_sq))
                if not wedge:
                    wedge, first, turn = True, angle, 0.0
                low, high = max(low, turn - half), min(high, turn + half)
                if low > high + 1e-9:
                    break
    count = 0
    k = n
    while k > 0:
        k = previous[k]
        count += 1
    kept = np.empty(count, np.int64)
    k = n
    for slot in range(count - 1, -1, -1):
        k = previous[k]
        kept[slot] = k
    return kept
