"""Trajectory optimisation (report section 4.4): remove way points that a straight line makes unnecessary."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import Bools, Floats, FreeSpace, line_cost, line_touches

_NEAR = 0.1  # cells; so near to the middle of a narrow gap a straight line passes through it
_AS_CHEAP = 1.001  # a straight line may cost so much more than the way points that it takes the place of


def shortcut(space: FreeSpace, path_world: Array) -> Array:
    """(M, 2) the way points of (N, 2) `path_world` that remain when each leads to the furthest possible one.

    Both ends remain. A segment that replaces others touches no blocked cell, costs a thousandth more at most, and
    passes narrow gaps through the middle. So a free path stays free.
    """
    path = np.asarray(path_world, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 2:
        raise ValueError(f"path_world: expected shape (N, 2), got {path.shape}")
    kept = _kept(space.blocked, space.cost, space.offsets, space.in_cells(path))
    return np.asarray(path[kept])


@numba.njit(cache=True, error_model="numpy")
def _kept(blocked: Bools, cost: Floats, offsets: Floats, path: Array) -> NDArray[np.int64]:
    """The indices of the way points that remain of a path (N, 2), in cells from the corner of the cells (H, W)."""
    spent = np.zeros(len(path))
    for i in range(1, len(path)):
        spent[i] = spent[i - 1] + line_cost(cost, path[i - 1, 0], path[i - 1, 1], path[i, 0], path[i, 1])
    kept, at = np.zeros(len(path), dtype=np.int64), 0
    count = 1 if len(path) else 0
    while at < len(path) - 1:
        for to in range(len(path) - 1, at, -1):
            ends = path[at, 0], path[at, 1], path[to, 0], path[to, 1]
            if to == at + 1 or (
                not line_touches(blocked, *ends)
                and _keeps_to_gaps(offsets, *ends, _NEAR)
                and line_cost(cost, *ends) <= _AS_CHEAP * (spent[to] - spent[at])
            ):
                at = to
                break
        kept[count] = at
        count += 1
    return kept[:count]


@numba.njit(cache=True, error_model="numpy")
def is_free(blocked: Bools, offsets: Floats, path: Array, tolerance: float) -> bool:
    """Whether a path (N, 2), in cells from the corner of the cells (H, W), touches no blocked one.

    It has to pass narrow gaps, the cells with `offsets` (H, W, 2), through the middle, up to a tolerance.
    """
    for i in range(len(path) - 1):
        ends = path[i, 0], path[i, 1], path[i + 1, 0], path[i + 1, 1]
        if line_touches(blocked, *ends) or not _keeps_to_gaps(offsets, *ends, tolerance):
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _keeps_to_gaps(offsets: Floats, x0: float, y0: float, x1: float, y1: float, tolerance: float) -> bool:
    """Whether a segment passes each narrow gap where a way leads through it, up to a tolerance; all in cells.

    Cells of a gap are those with `offsets` (H, W, 2). The segment is looked at once in half a cell.
    """
    height, width = offsets.shape[:2]
    length = math.hypot(x1 - x0, y1 - y0)
    for k in range(math.ceil(2.0 * length) + 1):
        share = min(0.5 * k / length, 1.0) if length > 0.0 else 0.0
        row, col = math.floor(y0 + share * (y1 - y0)), math.floor(x0 + share * (x1 - x0))
        if not (0 <= row < height and 0 <= col < width):
            continue
        down, across = offsets[row, col]
        if down != 0.0 or across != 0.0:
            x, y = col + 0.5 + across - x0, row + 0.5 + down - y0
            along = min(max((x * (x1 - x0) + y * (y1 - y0)) / (length * length), 0.0), 1.0) if length > 0.0 else 0.0
            if math.hypot(x - along * (x1 - x0), y - along * (y1 - y0)) > tolerance:
                return False
    return True
