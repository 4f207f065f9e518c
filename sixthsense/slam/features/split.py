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


@numba.njit(cache=True, error_model="numpy")
def split_pieces(
    points: Array, pieces: Indices, cyclic: bool, epsilon: float, min_points: int
) -> tuple[Indices, Indices]:
    """Second-level partitions (S, 2), first and past-last return, and (S,) the piece of (P, 2) that each is part of.

    A return at which a piece was split may lie on either wall, so it is in neither. With `epsilon` infinite nothing is
    split; a piece of fewer than `min_points` is left out. A `cyclic` piece is the whole scan, whose ends are a split.
    """
    most = len(points) + len(pieces)
    spans, owners, count = np.empty((most, 2), np.int64), np.empty(most, np.int64), 0
    for p in range(len(pieces)):
        first, past = pieces[p, 0], pieces[p, 1]
        if past - first < min_points:
            continue
        ends = split(points, first, past - 1, epsilon)
        for k in range(len(ends) - 1):
            a, b = ends[k], ends[k + 1]
            spans[count, 0] = a if a == first and not cyclic else a + 1
            spans[count, 1] = b + 1 if b == past - 1 and not cyclic else b
            owners[count] = p
            count += 1
    return spans[:count], owners[:count]
