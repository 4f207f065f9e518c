"""Submaps: the points of consecutive keyframes in the frame of one of them, and pyramids of cells to search in."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.scan_store import Returns, bearings_at

CELL_M = 0.1
VOXEL_M = 0.05  # of the points that a submap is made of
BLOCK = 4  # cells along the side of a block
PEAK = 17  # of a cell with a point; sums of some thousand points fit into 16 bits
_RANGE_M = 12.0  # farther returns are few and their place depends on the heading
_SIDE, _CORNER = 10, 6  # of the cells beside one with a point
_HALF_CELLS = 600  # of the square in which each voxel is taken once


class Pyramid(NamedTuple):
    """How well a point fits into a submap, by cell and by block of cells."""

    values: NDArray[np.uint8]
    """(columns, rows), `PEAK` for a cell with a point"""
    blocks: NDArray[np.uint8]
    """(BLOCK, BLOCK, n, m), at (a, b, i, j) the maximum over BLOCK x BLOCK cells from (BLOCK i + a, BLOCK j + b) on"""
    x0: float
    """m, submap's frame, of the first cell's corner"""
    y0: float


def submap_points(returns: Returns, keys: NDArray[np.int64], at: Array, voxel_m: float) -> Array:
    """(N, 2) points of keyframes in the frame of their poses `at` (n, 3), one per voxel."""
    return np.asarray(_gathered(returns, keys, np.ascontiguousarray(at), voxel_m))


def pyramid(points: Array) -> Pyramid:
    """The pyramid of points (N, 2); where there are none, no point fits."""
    if not len(points):
        return Pyramid(np.zeros((BLOCK, BLOCK), np.uint8), np.zeros((BLOCK, BLOCK, 1, 1), np.uint8), 0.0, 0.0)
    # Around the points there is room for a block: one that is not wholly inside the cells holds no point.
    low = points.min(axis=0) - CELL_M * (BLOCK + 1)
    cells = BLOCK * (((points.max(axis=0) + CELL_M - low) / CELL_M).astype(np.int64) // BLOCK + 2)
    values = np.zeros((cells[0], cells[1]), dtype=np.uint8)
    _draw(points, float(low[0]), float(low[1]), values)
    return Pyramid(values, _pooled(values), float(low[0]), float(low[1]))


@numba.njit(cache=True, error_model="numpy")
def _gathered(returns: Returns, keys: NDArray[np.int64], poses: Array, voxel_m: float) -> Array:
    seen = np.zeros((2 * _HALF_CELLS, 2 * _HALF_CELLS), np.bool_)
    out, n = np.empty((len(keys) * returns.points.shape[1], 2)), 0
    for k in range(len(keys)):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for i in range(bearings_at(returns, keys[k]).beams):
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
                value = PEAK if a == i and b == j else (_SIDE if a == i or b == j else _CORNER)
                values[a, b] = max(values[a, b], value)


@numba.njit(cache=True, error_model="numpy")
def _pooled(values: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The blocks' maxima, (BLOCK, BLOCK, n, m)."""
    columns, rows = values.shape
    along = np.zeros_like(values)
    for i in range(columns):
        for j in range(rows):
            for k in range(j, min(j + BLOCK, rows)):
                along[i, j] = max(along[i, j], values[i, k])
    blocks = np.zeros((BLOCK, BLOCK, columns // BLOCK, rows // BLOCK), np.uint8)
    for i in range(columns):
        for j in range(rows):
            value = along[i, j]
            for k in range(i + 1, min(i + BLOCK, columns)):
                value = max(value, along[k, j])
            blocks[i % BLOCK, j % BLOCK, i // BLOCK, j // BLOCK] = value
    return blocks
