"""Trajectory optimisation (report section 4.4): remove way points that a straight line makes unnecessary."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import Bools, FreeSpace, as_point, line_touches


def furthest_visible(space: FreeSpace, point: ArrayLike, path_world: Array, index: int) -> int:
    """Index of the last way point of (N, 2) `path_world`, from `index` on, that a free segment joins to `point`.

    If there is none it is `index` itself: a robot inside the inflation leaves it along the path as planned. Raises
    ValueError when `index` is outside the path.
    """
    path, here = _as_path(path_world), as_point("point", point)
    if not 0 <= index < len(path):
        raise ValueError(f"index: found {index}, allowed: 0 to {len(path) - 1}")
    return int(_furthest(space.blocked, space.in_cells(here), space.in_cells(path), index))


def shortcut(space: FreeSpace, path_world: Array) -> Array:
    """(M, 2) the way points of (N, 2) `path_world` that remain when each leads to the furthest one visible from it.

    Both ends remain. A segment that replaces others touches no blocked cell, so a free path stays free and no path gets
    longer.
    """
    path = _as_path(path_world)
    cells = space.in_cells(path)
    kept = [0] if len(path) else []
    while kept and kept[-1] < len(path) - 1:
        kept.append(int(_furthest(space.blocked, cells[kept[-1]], cells, kept[-1] + 1)))
    return path[kept]


def path_is_free(space: FreeSpace, path_world: Array) -> bool:
    """Whether no segment of (N, 2) `path_world` touches a blocked cell."""
    path = _as_path(path_world)
    if len(path) == 1:
        return not space.is_blocked(path[0])
    return bool(_is_free(space.blocked, space.in_cells(path)))


@numba.njit(cache=True, error_model="numpy")
def _furthest(blocked: Bools, here: Array, path: Array, index: int) -> int:
    """As `furthest_visible`, with points in cells from the corner of `blocked` (H, W)."""
    for i in range(len(path) - 1, index, -1):
        if not line_touches(blocked, here[0], here[1], path[i, 0], path[i, 1]):
            return i
    return index


@numba.njit(cache=True, error_model="numpy")
def _is_free(blocked: Bools, path: Array) -> bool:
    """As `path_is_free`, with points in cells from the corner of `blocked` (H, W)."""
    for i in range(len(path) - 1):
        if line_touches(blocked, path[i, 0], path[i, 1], path[i + 1, 0], path[i + 1, 1]):
            return False
    return True


def _as_path(path_world: Array) -> Array:
    path = np.asarray(path_world, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 2:
        raise ValueError(f"path_world: expected shape (N, 2), got {path.shape}")
    return path
