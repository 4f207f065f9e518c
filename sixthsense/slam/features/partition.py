"""Partitions of a scan in two levels, by jumps of the range and by the corners of walls.

First level: between neighbouring ranges that jump (report eq. 4; Borges and Aldon 2004). Second level: iterative end
point fitting (report algorithm 1; Ramer 1972, Douglas and Peucker 1973).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array

Indices = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def _is_break(r0: float, r1: float, gap: float, spacing: float, epsilon: float, incidence: float, sigma: float) -> bool:
    """Whether two neighbouring returns, `gap` apart in bearing, with beams `spacing` apart, are in two partitions.

    `incidence`, rad, is the flattest at which one wall is met; 0 selects the fixed jump `epsilon`, m. `sigma`, m, is of
    a range.
    """
    if not (math.isfinite(r0) and math.isfinite(r1)):
        return True
    if incidence <= 0.0:
        return abs(r1 - r0) > epsilon  # report eq. 4
    # Borges and Aldon 2004, eq. 9: the farthest the next return can be if the wall is met no flatter than `incidence`.
    gap_sq = r0 * r0 + r1 * r1 - 2.0 * r0 * r1 * math.cos(gap)
    allowed = min(r0, r1) * math.sin(spacing) / math.sin(max(incidence - spacing, 1e-3)) + 3.0 * sigma
    return gap_sq > allowed * allowed


@numba.njit(cache=True, error_model="numpy")
def partition(
    ranges: Array, gaps: Array, spacing: float, closed: bool, epsilon: float, incidence: float, sigma: float
) -> tuple[int, Indices, bool]:
    """Split a scan into runs of returns without a jump.

    `ranges` (N,) metres, inf for no return; `gaps` (N,) radians between each beam and the one before, and `spacing`
    their usual value; `closed` if the first beam follows the last; `epsilon`, `incidence`, `sigma` as of `_is_break`.
    Returns `(offset, pieces, cyclic)`: piece p covers the beams `(offset + k) % N` for k in `range(*pieces[p])`;
    `cyclic` says that the only piece closes on itself.
    """
    n = ranges.shape[0]
    offset = 0
    cyclic = False
    if closed:
        # Begin at a break, so that no piece straddles the seam; a scan without any begins at its farthest return,
        # which lies in a corner.
        offset = -1
        for i in range(n):
            if _is_break(ranges[i - 1], ranges[i], gaps[i], spacing, epsilon, incidence, sigma):
                offset = i
                break
        if offset < 0:
            offset = int(np.argmax(ranges))
            cyclic = True
    pieces = np.empty((n, 2), np.int64)
    count = 0
    for k in range(n):
        r = ranges[(offset + k) % n]
        if not math.isfinite(r):
            continue
        before, gap = ranges[(offset + k - 1) % n], gaps[(offset + k) % n]
        if k == 0 or _is_break(before, r, gap, spacing, epsilon, incidence, sigma):
            pieces[count, 0] = k
            count += 1
        pieces[count - 1, 1] = k + 1
    return offset, pieces[:count].copy(), cyclic


@numba.njit(cache=True, error_model="numpy")
def _farthest(points: Array, first: int, last: int) -> tuple[int, float]:
    """The point between two end points that lies farthest from the line through them, and how far."""
    ex, ey = points[last, 0] - points[first, 0], points[last, 1] - points[first, 1]
    length = math.hypot(ex, ey)
    index, distance = first, 0.0
    for i in range(first + 1, last):
        px, py = points[i, 0] - points[first, 0], points[i, 1] - points[first, 1]
        # Of a closed outline both ends may coincide: then the distance to the point itself decides.
        d = abs(px * ey - py * ex) / length if length > 0.0 else math.hypot(px, py)
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
