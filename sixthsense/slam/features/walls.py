"""Walls of a scan as landmarks, with the loose ends that are known beside them.

Each laser return is evidence once: a loose end has returns of its own, which its wall does without, and a corner, which
is where two walls meet, has none and is no landmark here.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.landmarks import (
    LOOSE,
    NOTHING,
    clear_of_corners,
    loose_end,
    mark_corners,
    mark_ends,
    mean_spacing,
)
from sixthsense.slam.features.lines import fit_line, parallel_line
from sixthsense.slam.features.partition import Indices

# A wall's return lies within the threshold of its neighbour's line as often as the threshold goes into their spacing:
# returns this many thresholds apart are trusted.
_DENSE = 4.0


@numba.njit(cache=True, error_model="numpy")
def _gap(points: Array, i: int, k: int) -> float:
    """From one return to another, metres."""
    return math.hypot(points[i, 0] - points[k, 0], points[i, 1] - points[k, 1])


@numba.njit(cache=True, error_model="numpy")
def _surely_own(points: Array, mine: Indices, first: bool, last: bool, within: float) -> Indices:
    """The returns at `mine` but the first and the last, where asked for and nearer than `within` to the next.

    A neighbour that shows too little of itself to be found as a line leaves a return near this one now and then, two or
    three sigmas off and at the end, where it turns the line most.
    """
    begin, end = 0, len(mine)
    if first and end > 1 and _gap(points, mine[0], mine[1]) < within:
        begin = 1
    if last and end - begin > 1 and _gap(points, mine[end - 1], mine[end - 2]) < within:
        end -= 1
    return mine[begin:end]


@numba.njit(cache=True, error_model="numpy")
def find_walls(
    points: Array,
    ranges: Array,
    bearings: Array,
    pieces: Indices,
    piece_of_line: Indices,
    lines: Array,
    where: Indices,
    owner: Indices,
    closed: bool,
    cyclic: bool,
    use_ends: bool,
    max_gap: float,
    min_angle: float,
    max_range: float,
    margin: float,
    min_points: int,
    threshold: float,
    min_length: float,
    reserved: int,
    sigma_range: float,
    sigma_bearing: float,
) -> tuple[Array, Array]:
    """Walls and loose ends of one scan, all in the laser's frame, metres and radians; arguments as `find_landmarks`.

    A loose end takes the last `reserved` returns on its side, its wall all others but those near a corner and, on a
    side with neither, an outermost one in doubt; so few returns say nothing of a direction, which is the wall's.
    Returns (W, 7) alpha, d, aa, ad, dd and from where to where along the wall it was seen; and (E, 5) x, y, xx, xy, yy.
    """
    count, spacing = len(lines), mean_spacing(bearings)
    corners = np.full((count, 2), NOTHING, np.int64)
    ends = np.full((count, 2), NOTHING, np.int64)
    mark_corners(points, piece_of_line, lines, where, cyclic, max_gap, min_angle, corners)
    if use_ends and not cyclic:
        mark_ends(
            ranges,
            bearings,
            pieces,
            piece_of_line,
            lines,
            where,
            closed,
            max_range,
            margin,
            min_points,
            threshold,
            ends,
        )
    walls, found = np.empty((count, 7)), np.empty((2 * count, 5))
    w = e = 0
    for j in range(count):
        mine = clear_of_corners(points, np.flatnonzero(owner == j), j, lines, corners, sigma_range)
        at_first = ends[j, 0] == LOOSE and len(mine) >= 2 * reserved
        first_own = mine[: reserved if at_first else 0]
        mine = mine[len(first_own) :]
        at_last = ends[j, 1] == LOOSE and len(mine) >= 2 * reserved
        last_own = mine[len(mine) - (reserved if at_last else 0) :]
        mine = mine[: len(mine) - len(last_own)]
        unknown_first = corners[j, 0] == NOTHING and not at_first
        unknown_last = corners[j, 1] == NOTHING and not at_last
        mine = _surely_own(points, mine, unknown_first, unknown_last, _DENSE * threshold)
        if len(mine) < 3:
            continue
        fit = fit_line(points, mine, sigma_range, sigma_bearing)
        for side, own, step in ((0, first_own, -spacing), (1, last_own, spacing)):
            if len(own):
                across = parallel_line(points, own, fit, sigma_range, sigma_bearing)
                found[e] = loose_end(across, bearings[where[j, 1 + side]], step, sigma_bearing)
                e += 1
        c, s = math.cos(fit[0]), math.sin(fit[0])
        first, last = points[where[j, 1]], points[where[j, 2]]
        a, b = first[1] * c - first[0] * s, last[1] * c - last[0] * s
        if abs(b - a) >= min_length:
            walls[w, :5] = fit
            walls[w, 5], walls[w, 6] = min(a, b), max(a, b)
            w += 1
    return walls[:w].copy(), found[:e].copy()
