"""The middle of gaps: a path by cells is moved to where obstacles on both sides are as far away.

An elastic band (Quinlan and Khatib, ICRA 1993): in each of a few rounds each point moves across the path by half
of the difference between the distances to the nearest obstacles on its two sides.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.planners.shortcut import path_is_free
from sixthsense.navigation.ways import NEAR_M
from sixthsense.slam.mapping.changes import box_of
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_ROUNDS = 4  # the first moves a point to the middle between straight walls, the others it and its neighbours at corners


def centred(grid: Grid, space: FreeSpace, path: Array) -> Array | None:
    """The path (N, 2), its first part off obstacles, in the middle between two that are near; the ends stay.

    None if there is nothing to move, or if that would leave the free space.
    """
    cell_m, tight_m = space.cell_m, grid.inflation_m
    reach_m = tight_m + cell_m
    path = _apart(path, 0.5 * cell_m)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    past = min(NEAR_M, along[-1])
    knots = np.append(along[along < past], past)
    steps = np.ceil(np.diff(knots) / cell_m).astype(np.int64)  # none where the path was centred before
    pieces = (np.linspace(a, b, n + 1)[1:] for a, b, n in zip(knots[:-1], knots[1:], steps, strict=True))
    at = np.concatenate([knots[:1], *pieces])
    dense = np.column_stack([np.interp(at, along, path[:, axis]) for axis in (0, 1)])
    box = box_of(np.floor(dense[:, ::-1] / cell_m).astype(np.int64)).grown(int(reach_m / cell_m) + 2)
    is_moved = np.zeros(len(dense), dtype=np.bool_)
    _centre(dense, grid.obstacle_points(box), (tight_m, reach_m), is_moved)
    if not is_moved.any():
        return None
    kept = (is_moved | np.isin(at, along)) & (at < past)
    found = np.vstack([dense[kept], path[along >= past]])
    return found if path_is_free(space, found) else None


def _apart(path: Array, least_m: float) -> Array:
    """The path (N, 2) without points that are nearer to the one before than `least_m`, which have no direction.

    A path is centred at each keyframe, and in the middle of a bend its points come together.
    """
    kept = [0]
    for k in range(1, len(path) - 1):
        if min(math.dist(path[k], path[kept[-1]]), math.dist(path[k], path[-1])) >= least_m:
            kept.append(k)
    return path[[*kept, len(path) - 1]]


@numba.njit(cache=True, error_model="numpy")
def _centre(path: Array, points: Array, limits: tuple[float, float], is_moved: Bools) -> None:
    """Move the points of a path (N, 2) to the middle between points (M, 2) on both sides, and mark those moved.

    Those are moved that are nearer than the first limit to one side; what is farther than the second does not count.
    """
    tight, reach = limits
    for _ in range(_ROUNDS):
        before = path.copy()
        for i in range(1, len(path) - 1):
            tx, ty = before[i + 1, 0] - before[i - 1, 0], before[i + 1, 1] - before[i - 1, 1]
            norm = np.hypot(tx, ty)
            if norm == 0.0:
                continue
            left = right = reach
            for k in range(len(points)):
                x, y = points[k, 0] - before[i, 0], points[k, 1] - before[i, 1]
                away = np.hypot(x, y)
                if tx * y - ty * x > 0.0:
                    left = min(left, away)
                else:
                    right = min(right, away)
            if min(left, right) < tight:  # the other side counts up to its reach: before a gap there may be none
                shift = 0.5 * (left - right) / norm
                path[i, 0], path[i, 1] = before[i, 0] - ty * shift, before[i, 1] + tx * shift
                is_moved[i] = True
