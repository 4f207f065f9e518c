"""Second level: iterative end point fitting (report algorithm 1; Ramer 1972, Douglas and Peucker 1973)."""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.partition import Indices


@numba.njit(cache=True, error_model="numpy")
def _farthest(points: Array, first: int, last: int) -> tuple[int, float]:
    """The point between two end points that lies farthest from the line through them, and how far."""
    ex, ey = points[last, 0] - points[first, 0], points[last, 1] - points[first, 1]
    length = math.hypot(ex, ey)
    index, distance = first, 0.0
    for i in range(first + 1, last):
        px, py = points[i, 0] - points[first, 0], points[i, 1] - points[first, 1]
        # Of a closed outline both ends may coincide: then the distance to the point itself decides.
        d = abs(px * ey - py * ex) / length if length > 1e-9 else math.hypot(px, py)
        if d > distance:
            index, distance = i, d
    return index, distance


@numba.njit(cache=True, error_model="numpy")
def split(points: Array, first: int, last: int, epsilon: float) -> Indices:
    """End points of the serially connected walls in `points[first:last + 1]`.

    `points` (N, 2) and `epsilon` in metres. Returns ascending indices, `first` and `last` among them, such that no
    point lies farther than `epsilon` from the line through the end points around it.
    """
    is_end = np.zeros(last - first + 1, np.bool_)
    is_end[0] = is_end[last - first] = True
    stack = [(first, last)]
    while len(stack) > 0:
        a, b = stack.pop()
        index, distance = _farthest(points, a, b)
        if distance > epsilon:
            is_end[index - first] = True
            stack.append((a, index))
            stack.append((index, b))
    return first + np.flatnonzero(is_end)
