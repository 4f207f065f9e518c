"""The best pose of points in a submap within a window, by branch and bound.

Hess, Kohler, Rapp and Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.submap import CELL_M, LEVELS, Pyramid

STEP_RAD = 0.012
"""between two headings that are tried"""


class Window(NamedTuple):
    """Poses to search."""

    centre: Array
    """(3,) x, y, theta in the submap's frame"""
    half_m: float
    """half the side of the square of positions"""
    half_rad: float
    """half the interval of headings"""


class Excluded(NamedTuple):
    """Poses that are left out: those near one that was found before."""

    pose: Array
    """(3,)"""
    radius_m: float
    """0: none are left out"""
    radius_rad: float


NOTHING = Excluded(np.zeros(3), 0.0, 0.0)


class Found(NamedTuple):
    """The best pose."""

    score: float
    """mean value of the points' cells, 0 to 1; the least score asked for if there is none above"""
    pose: Array
    """(3,) in the submap's frame"""


def best_pose(
    pyramid: Pyramid, points: Array, window: Window, least: float, excluded: Excluded = NOTHING
) -> Found | None:
    """The pose with the best score above `least` of points (N, 2) in the window; None if there is none."""
    out = np.zeros(4)
    if not _search(pyramid, points, window, least, excluded, out):
        return None
    return Found(float(out[0]), out[1:].copy())


@numba.njit(cache=True, error_model="numpy")
def _score(values: NDArray[np.uint8], columns: NDArray[np.int32], rows: NDArray[np.int32], dx: int, dy: int) -> float:
    total, width, height = 0, values.shape[0], values.shape[1]
    for k in range(len(columns)):
        i, j = columns[k] + dx, rows[k] + dy
        if 0 <= i < width and 0 <= j < height:
            total += values[i, j]
    return total / (255.0 * len(columns))


@numba.njit(cache=True, error_model="numpy")
def _search(pyramid: Pyramid, points: Array, window: Window, least: float, excluded: Excluded, out: Array) -> bool:
    """Write score and pose of the best into `out` (4,); whether there is one above `least`."""
    turns, cells, top = 2 * int(window.half_rad / STEP_RAD) + 1, int(window.half_m / CELL_M), 1 << (LEVELS - 1)
    columns, rows = _cells(pyramid, points, window, turns)
    starts = (2 * cells) // top + 1
    scores, nodes, n = np.empty(turns * starts * starts), np.empty((turns * starts * starts, 3), np.int32), 0
    for a in range(turns):
        for dx in range(-cells, cells + 1, top):
            for dy in range(-cells, cells + 1, top):
                score = _score(pyramid.values[LEVELS - 1], columns[a], rows[a], dx, dy)
                if score > least:
                    scores[n] = score
                    nodes[n, 0], nodes[n, 1], nodes[n, 2] = a, dx, dy
                    n += 1
    best, found = least, False
    stack, bounds = np.empty((4 * LEVELS + 4, 4), np.int32), np.empty(4 * LEVELS + 4)
    children = np.empty(4)
    for first in np.argsort(-scores[:n]):
        if scores[first] <= best:
            break
        size = 1
        bounds[0] = scores[first]
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = (
            nodes[first, 0],
            nodes[first, 1],
            nodes[first, 2],
            LEVELS - 1,
        )
        while size > 0:
            size -= 1
            a, dx, dy, level = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            bound = bounds[size]
            if bound <= best:
                continue
            if level == 0:
                x, y = window.centre[0] + dx * CELL_M, window.centre[1] + dy * CELL_M
                theta = window.centre[2] + (a - turns // 2) * STEP_RAD
                if abs(dx) <= cells and abs(dy) <= cells and not _is_excluded(excluded, x, y, theta):
                    best, found = bound, True
                    out[0], out[1], out[2], out[3] = best, x, y, theta
                continue
            half = 1 << (level - 1)
            for u in range(4):
                children[u] = _score(
                    pyramid.values[level - 1], columns[a], rows[a], dx + half * (u & 1), dy + half * (u >> 1)
                )
            for u in np.argsort(children):  # the best on top of the stack
                if children[u] > best:
                    bounds[size] = children[u]
                    stack[size, 0], stack[size, 3] = a, level - 1
                    stack[size, 1], stack[size, 2] = dx + half * (u & 1), dy + half * (u >> 1)
                    size += 1
    return found


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


@numba.njit(cache=True, error_model="numpy")
def _is_excluded(excluded: Excluded, x: float, y: float, theta: float) -> bool:
    if excluded.radius_m == 0.0:
        return False
    turn = (theta - excluded.pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    off = math.hypot(x - excluded.pose[0], y - excluded.pose[1])
    return off < excluded.radius_m and abs(turn) < excluded.radius_rad
