"""Trajectory optimisation (report section 4.4): remove way points that a straight line makes unnecessary."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import FreeSpace, as_point


def furthest_visible(space: FreeSpace, point: ArrayLike, path_world: Array, index: int) -> int:
    """Index of the last way point of (N, 2) `path_world`, from `index` on, that a free segment joins to `point`.

    If there is none it is `index` itself: a robot inside the inflation leaves it along the path as planned. Raises
    ValueError when `index` is outside the path.
    """
    path, here = _as_path(path_world), as_point("point", point)
    if not 0 <= index < len(path):
        raise ValueError(f"index: found {index}, allowed: 0 to {len(path) - 1}")
    for i in range(len(path) - 1, index, -1):
        if space.line_is_free(here, path[i]):
            return i
    return index


def shortcut(space: FreeSpace, path_world: Array) -> Array:
    """(M, 2) the way points of (N, 2) `path_world` that remain when each leads to the furthest one visible from it.

    Both ends remain. A segment that replaces others touches no blocked cell, so a free path stays free and no path gets
    longer.
    """
    path = _as_path(path_world)
    kept = [0] if len(path) else []
    while kept and kept[-1] < len(path) - 1:
        kept.append(furthest_visible(space, path[kept[-1]], path, kept[-1] + 1))
    return path[kept]


def path_is_free(space: FreeSpace, path_world: Array) -> bool:
    """Whether no segment of (N, 2) `path_world` touches a blocked cell."""
    path = _as_path(path_world)
    if len(path) == 1:
        return not space.is_blocked(path[0])
    return all(space.line_is_free(a, b) for a, b in pairwise(path))


def _as_path(path_world: Array) -> Array:
    path = np.asarray(path_world, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 2:
        raise ValueError(f"path_world: expected shape (N, 2), got {path.shape}")
    return path
