"""All places of points in a submap within a window, by branch and bound.

Hess, Kohler, Rapp and Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, search for the best one alone. What
is bounded here is the least score that is asked for, so that the places that look alike are found together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.submap import CELL_M, Pyramid

STEP_RAD = 0.012
"""between two headings that are tried"""
MOST_PEAKS = 64
"""places that are returned at most"""

_COARSE, _FINE = 4, 2  # levels of the blocks of cells that are bounded; each of the finer ones holds one place


class Window(NamedTuple):
    """Poses to search."""

    centre: Array
    """(3,) x, y, theta in the submap's frame"""
    half_m: float
    """half the side of the square of positions"""
    half_rad: float
    """half the interval of headings"""


class Apart(NamedTuple):
    """How far two poses must be from each other to be of two places; one of both is enough."""

    distance_m: float
    turn_rad: float


def peaks(pyramid: Pyramid, points: Array, window: Window, least: float, apart: Apart) -> Array:
    """(m, 4) score and pose in the submap's frame of all places of points (N, 2) in the window, the best first.

    A score is the mean value of the points' cells, 0 to 1, and above `least`.
    """
    turns = 2 * int(window.half_rad / STEP_RAD) + 1
    columns, rows = _cells(pyramid, points, window, turns)
    blocks, count = _blocks(pyramid, columns, rows, window, least)
    best = _best_of_blocks(pyramid, columns, rows, window, blocks[:count], least)
    return _apart(best[np.argsort(-best[:, 0], kind="stable")], apart)


@numba.njit(cache=True, error_model="numpy")
def _blocks(
    pyramid: Pyramid, columns: NDArray[np.int32], rows: NDArray[np.int32], window: Window, least: float
) -> tuple[NDArray[np.int32], int]:
    """(n, 3) heading and first cell of the blocks that may hold a score above `least`, and how many they are."""
    cells, side, wide = int(window.half_m / CELL_M), 1 << _FINE, 1 << _COARSE
    blocks, n = np.empty((256, 3), np.int32), 0
    for a in range(len(columns)):
        for left in range(-cells, cells + 1, wide):
            for low in range(-cells, cells + 1, wide):
                if _score(pyramid.values[_COARSE], columns[a], rows[a], left, low) <= least:
                    continue
                for dx in range(left, min(left + wide, cells + 1), side):
                    for dy in range(low, min(low + wide, cells + 1), side):
                        if _score(pyramid.values[_FINE], columns[a], rows[a], dx, dy) <= least:
                            continue
                        if n == len(blocks):
                            blocks = np.concatenate((blocks, np.empty_like(blocks)))
                        blocks[n, 0], blocks[n, 1], blocks[n, 2] = a, dx, dy
                        n += 1
    return blocks, n


@numba.njit(cache=True, error_model="numpy")
def _best_of_blocks(
    pyramid: Pyramid,
    columns: NDArray[np.int32],
    rows: NDArray[np.int32],
    window: Window,
    blocks: NDArray[np.int32],
    least: float,
) -> Array:
    """(m, 4) score and pose of the best cell of each block that has one above `least`."""
    cells, side, turns = int(window.half_m / CELL_M), 1 << _FINE, len(columns)
    found, count = np.empty((len(blocks), 4)), 0
    for k in range(len(blocks)):
        best, x, y, a = least, 0, 0, blocks[k, 0]
        for dx in range(blocks[k, 1], min(blocks[k, 1] + side, cells + 1)):
            for dy in range(blocks[k, 2], min(blocks[k, 2] + side, cells + 1)):
                score = _score(pyramid.values[0], columns[a], rows[a], dx, dy)
                if score > best:
                    best, x, y = score, dx, dy
        if best > least:
            found[count, 0] = best
            found[count, 1], found[count, 2] = window.centre[0] + x * CELL_M, window.centre[1] + y * CELL_M
            found[count, 3] = window.centre[2] + (a - turns // 2) * STEP_RAD
            count += 1
    return found[:count]


@numba.njit(cache=True, error_model="numpy")
def _apart(found: Array, apart: Apart) -> Array:
    """(m, 4) of `found` (n, 4), the best first: those that are apart from all better ones."""
    kept, m = np.empty((MOST_PEAKS, 4)), 0
    for k in range(len(found)):
        is_new = True
        for q in range(m):
            near = math.hypot(found[k, 1] - kept[q, 1], found[k, 2] - kept[q, 2]) < apart.distance_m
            if near and abs(found[k, 3] - kept[q, 3]) < apart.turn_rad:
                is_new = False
                break
        if is_new:
            kept[m] = found[k]
            m += 1
            if m == MOST_PEAKS:
                break
    return kept[:m].copy()


@numba.njit(cache=True, error_model="numpy")
def _score(values: NDArray[np.uint8], columns: NDArray[np.int32], rows: NDArray[np.int32], dx: int, dy: int) -> float:
    total, width, height = 0, values.shape[0], values.shape[1]
    for k in range(len(columns)):
        i, j = columns[k] + dx, rows[k] + dy
        if 0 <= i < width and 0 <= j < height:
            total += values[i, j]
    return total / (255.0 * len(columns))


@numba.njit(cache=True, error_model="numpy")
def _cells(pyramid: Pyramid, points: Array, window: Window, turns: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Columns and rows (turns, N) of the points at the window's centre, for each heading."""
    columns, rows = np.empty((turns, len(points)), np.int32), np.empty((turns, len(points)), np.int32)
    for a in range(turns):
        theta = window.centre[2] + (a - turns // 2) * STEP_RAD
        c, s = math.cos(theta), math.sin(theta)
        for k in range(len(points)):
            x = window.centre[0] + c * points[k, 0] - s * points[k, 1] - pyramid.x0
            y = window.centre[1] + s * points[k, 0] + c * points[k, 1] - pyramid.y0
            # The floor, not the nearest cell: whole shifts must keep the bounds valid.
            columns[a, k], rows[a, k] = math.floor(x / CELL_M), math.floor(y / CELL_M)
    return columns, rows
