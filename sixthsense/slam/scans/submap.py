"""Submaps: the points of consecutive key scans in the frame of one of them, and pyramids of cells to search in."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.poses import between
from sixthsense.slam.scans.scan_store import Returns

CELL_M = 0.1
LEVELS = 6
_RANGE_M = 12.0  # farther returns are few and their place depends on the heading
_PEAK, _SIDE, _CORNER = 255, 150, 90  # values of a cell with a point, and of those beside it
_HALF_CELLS = 600  # of the square in which each voxel is taken once


class Pyramid(NamedTuple):
    """How well a point fits into a submap, by cell; each level has the maximum over twice as many cells ahead."""

    values: NDArray[np.uint8]
    """(LEVELS, columns, rows), 255 for a cell with a point; level k has the maximum over 2^k x 2^k cells from there"""
    x0: float
    """m, submap's frame, of the first cell's corner"""
    y0: float


def submap_points(returns: Returns, keys: NDArray[np.int64], poses: Array, frame: Array, voxel_m: float) -> Array:
    """(N, 2) points of key scans in `frame` (3,), one per voxel; `poses` (K, 3) are those of all key scans."""
    seen = between(frame, poses[keys])
    return _gathered(returns, keys, seen, voxel_m)


def pyramid(points: Array) -> Pyramid:
    """The pyramid of points (N, 2)."""
    # Below the points there is room for the largest block: a block that begins outside the cells holds no point.
    low = points.min(axis=0) - CELL_M * ((1 << (LEVELS - 1)) + 1)
    cells = ((points.max(axis=0) + CELL_M - low) / CELL_M).astype(np.int64) + 1
    values = np.zeros((LEVELS, cells[0], cells[1]), dtype=np.uint8)
    _draw(points, float(low[0]), float(low[1]), values[0])
    for level in range(1, LEVELS):
        _pool(values[level - 1], 1 << (level - 1), values[level])
    return Pyramid(values, float(low[0]), float(low[1]))


@numba.njit(cache=True, error_model="numpy")
def _gathered(returns: Returns, keys: NDArray[np.int64], poses: Array, voxel_m: float) -> Array:
    seen = np.zeros((2 * _HALF_CELLS, 2 * _HALF_CELLS), np.bool_)
    out, n = np.empty((len(keys) * returns.bearings.beams, 2)), 0
    for k in range(len(keys)):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for i in range(returns.bearings.beams):
            px, py, r = returns.points[keys[k], i, 0], returns.points[keys[k], i, 1], returns.points[keys[k], i, 2]
            if r == 0.0 or r > _RANGE_M:
                continue
            x, y = poses[k, 0] + c * px - s * py, poses[k, 1] + s * px + c * py
            column, row = int(np.floor(x / voxel_m)) + _HALF_CELLS, int(np.floor(y / voxel_m)) + _HALF_CELLS
            if not (0 <= column < 2 * _HALF_CELLS and 0 <= row < 2 * _HALF_CELLS) or seen[column, row]:
                continue
            seen[column, row] = True
            out[n, 0], out[n, 1] = x, y
            n += 1
    return out[:n].copy()


@numba.njit(cache=True, error_model="numpy")
def _draw(points: Array, x0: float, y0: float, values: NDArray[np.uint8]) -> None:
    """Draw points into `values` (columns, rows) with a blur of one cell."""
    columns, rows = values.shape
    for k in range(len(points)):
        i, j = int((points[k, 0] - x0) / CELL_M), int((points[k, 1] - y0) / CELL_M)
        for a in range(max(i - 1, 0), min(i + 2, columns)):
            for b in range(max(j - 1, 0), min(j + 2, rows)):
                value = _PEAK if a == i and b == j else (_SIDE if a == i or b == j else _CORNER)
                values[a, b] = max(values[a, b], value)


@numba.njit(cache=True, error_model="numpy")
def _pool(fine: NDArray[np.uint8], step: int, coarse: NDArray[np.uint8]) -> None:
    """The maximum over the cells at 0 and `step` ahead, in both directions."""
    columns, rows = fine.shape
    for i in range(columns):
        for j in range(rows):
            value = fine[i, j]
            if i + step < columns:
                value = max(value, fine[i + step, j])
            if j + step < rows:
                value = max(value, fine[i, j + step])
            if i + step < columns and j + step < rows:
                value = max(value, fine[i + step, j + step])
            coarse[i, j] = value
