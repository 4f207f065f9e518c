"""Which places a robot can drive between in a scene, by its true walls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from sixthsense.core.geometry import Array

_CELL_M = 0.05
_SLACK_CELLS = 1.5
"""of a distance between cells, so that no place is called unreachable that is not"""


def connected(walls: Array, start: Array, goals: Array, radius_m: float) -> NDArray[np.bool_]:
    """(N,) whether a disc of `radius_m` may get from `start` (2,) to goals (N, 2) among walls (M, 2, 2), world frame.

    A gap that is narrower than the disc by a cell counts as one that it fits through.
    """
    places = np.vstack([start[None], goals])
    corners = np.concatenate([walls.reshape(-1, 2), places])
    low = corners.min(axis=0) - radius_m - 2.0 * _CELL_M
    shape = np.ceil((corners.max(axis=0) + radius_m + 2.0 * _CELL_M - low) / _CELL_M).astype(np.int64) + 1
    is_free = np.ones(tuple(shape), dtype=np.bool_)
    for first, last in walls:
        steps = math.ceil(2.0 * math.dist(first, last) / _CELL_M) + 1
        x, y = np.floor((np.linspace(first, last, steps) - low) / _CELL_M).astype(np.int64).T
        is_free[x, y] = False
    passable = distance_transform_edt(is_free) > radius_m / _CELL_M - _SLACK_CELLS
    parts, _ = label(passable, structure=np.ones((3, 3)))
    found = parts[tuple(np.floor((places - low) / _CELL_M).astype(np.int64).T)]
    return np.asarray((found[1:] == found[0]) | (found[0] == 0) | (found[1:] == 0))
