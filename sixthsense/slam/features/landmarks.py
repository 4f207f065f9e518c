"""Landmarks of a scan: corners and free ends, or walls with the free ends beside them.

Each laser return is evidence once. A wall with a point landmark at both ends feeds each from the half of its returns on
that side, so that the two are independent; a wall with one feeds it from all its returns. Where walls are landmarks, a
free end has returns of its own, which its wall does without; a corner, where two walls meet, is no landmark.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind
from sixthsense.slam.features.endpoints import (
    FREE_END,
    UNDECIDED,
    EndpointRules,
    RolledScan,
    clear_of_corners,
    free_end,
    intersect,
    mark_corners,
    mark_free_ends,
    mean_spacing,
)
from sixthsense.slam.features.line_fit import LaserSigmas, fit_line, parallel_line
from sixthsense.slam.features.lines import FittedLines
from sixthsense.slam.features.partition import Indices

CORNER, END = int(Kind.CORNER), int(Kind.END)
"""Values of `Kind`, which compiled code cannot read."""
END_RETURNS = 5
"""that a free end takes from its wall, so that each return is evidence once: fewer hardly average their noise"""
_MIN_LENGTH_M = 0.4
"""of a wall: shorter ones determine too little of their direction"""


@numba.njit(cache=True, error_model="numpy")
def _write(into: NDArray[Any], at: int, values: NDArray[Any]) -> None:
    """Copy `values` (n,) to places `at` and on: a loop makes a kernel that loads faster than a slice does."""
    for k in range(len(values)):
        into[at + k] = values[k]


@numba.njit(cache=True, error_model="numpy")
def _fit_sides(points: Array, lines: FittedLines, endpoint_type: Indices, sigmas: LaserSigmas) -> Array:
    """(L, 2, 5) fits of each line for the landmark at its first and at its last return; NaN where there is none.

    The two fits of a line share no return.
    """
    sides = np.full((len(lines.fits), 2, 5), np.nan)
    for j in range(len(lines.fits)):
        owned = np.flatnonzero(lines.owner == j)
        owned = clear_of_corners(points, owned, j, lines.fits, endpoint_type, sigmas.range_m)
        has_both = endpoint_type[j, 0] != UNDECIDED and endpoint_type[j, 1] != UNDECIDED
        middle = len(owned) // 2
        for side in range(2):
            half = owned
            if has_both:
                half = owned[:middle] if side == 0 else owned[middle:]
            if endpoint_type[j, side] != UNDECIDED and len(half) >= 3:
                _write(sides[j, side], 0, fit_line(points, half, sigmas))
    return sides


@numba.njit(cache=True, error_model="numpy")
def find_points(
    scan: RolledScan, lines: FittedLines, rules: EndpointRules, sigmas: LaserSigmas
) -> tuple[Indices, Array]:
    """Corners and free ends of one scan: (K,) kinds; (K, 5) x, y, xx, xy, yy in the laser's frame, metres."""
    count, spacing = len(lines.fits), mean_spacing(scan.bearings)
    endpoint_type = np.full((count, 2), UNDECIDED, np.int64)
    mark_corners(scan, lines, rules, endpoint_type)
    mark_free_ends(scan, lines, rules, endpoint_type)
    sides = _fit_sides(scan.points, lines, endpoint_type, sigmas)
    kinds, found, k = np.empty(2 * count, np.int64), np.empty((2 * count, 5)), 0
    for j in range(count):
        after = endpoint_type[j, 1]
        if after >= 0:
            kinds[k], found[k] = CORNER, intersect(sides[j, 1], sides[after, 0])
            k += 1
        for side, step in ((0, -spacing), (1, spacing)):
            if endpoint_type[j, side] == FREE_END:
                bearing = scan.bearings[lines.ends[j, side]]
                kinds[k], found[k] = END, free_end(sides[j, side], bearing, step, sigmas.bearing_rad)
                k += 1
    return kinds[:k].copy(), found[:k].copy()


# A return of the neighbouring wall lies within the threshold of this line with a probability of threshold over
# spacing. Outermost returns that are this many thresholds apart are therefore trusted.
_SPARSE_THRESHOLDS = 4.0


@numba.njit(cache=True, error_model="numpy")
def _distance(points: Array, i: int, k: int) -> float:
    """Distance between two returns, metres."""
    return math.hypot(points[i, 0] - points[k, 0], points[i, 1] - points[k, 1])


@numba.njit(cache=True, error_model="numpy")
def _trim_ambiguous_ends(points: Array, index: Indices, at_first: bool, at_last: bool, within: float) -> Indices:
    """The returns at `index` without the outermost ones, where asked for and if nearer than `within` to the next.

    A neighbouring wall that is too short to be found as a line leaves a return near this one now and then, two or
    three sigmas off and at the end, where it turns the line most.
    """
    begin, end = 0, len(index)
    if at_first and end > 1 and _distance(points, index[0], index[1]) < within:
        begin = 1
    if at_last and end - begin > 1 and _distance(points, index[end - 1], index[end - 2]) < within:
        end -= 1
    return index[begin:end]


@numba.njit(cache=True, error_model="numpy")
def find_walls(scan: RolledScan, lines: FittedLines, rules: EndpointRules, sigmas: LaserSigmas) -> tuple[Array, Array]:
    """Walls and free ends of one scan, all in the laser's frame, metres and radians.

    A free end takes the last `END_RETURNS` on its side. Its wall takes all others, except those near a corner and, on a
    side with neither, an ambiguous outermost return. So few returns determine no direction: a free end takes that of
    its wall. Walls shorter than `_MIN_LENGTH_M` are left out.
    Returns (W, 7) alpha, d, aa, ad, dd, and the first and last place along the wall that was seen; and (E, 5)
    x, y, xx, xy, yy.
    """
    count, spacing = len(lines.fits), mean_spacing(scan.bearings)
    corners = np.full((count, 2), UNDECIDED, np.int64)
    ends = np.full((count, 2), UNDECIDED, np.int64)
    mark_corners(scan, lines, rules, corners)
    if rules.ends:
        mark_free_ends(scan, lines, rules, ends)
    points = scan.points
    walls, found = np.empty((count, 7)), np.empty((2 * count, 5))
    w = e = 0
    for j in range(count):
        owned = clear_of_corners(points, np.flatnonzero(lines.owner == j), j, lines.fits, corners, sigmas.range_m)
        at_first = ends[j, 0] == FREE_END and len(owned) >= 2 * END_RETURNS
        of_first_end = owned[: END_RETURNS if at_first else 0]
        owned = owned[len(of_first_end) :]
        at_last = ends[j, 1] == FREE_END and len(owned) >= 2 * END_RETURNS
        of_last_end = owned[len(owned) - (END_RETURNS if at_last else 0) :]
        owned = owned[: len(owned) - len(of_last_end)]
        undecided_first = corners[j, 0] == UNDECIDED and not at_first
        undecided_last = corners[j, 1] == UNDECIDED and not at_last
        within = _SPARSE_THRESHOLDS * rules.threshold_m
        owned = _trim_ambiguous_ends(points, owned, undecided_first, undecided_last, within)
        if len(owned) < 3:
            continue
        fit = fit_line(points, owned, sigmas)
        for side, of_end, step in ((0, of_first_end, -spacing), (1, of_last_end, spacing)):
            if len(of_end):
                across = parallel_line(points, of_end, fit, sigmas)
                _write(found[e], 0, free_end(across, scan.bearings[lines.ends[j, side]], step, sigmas.bearing_rad))
                e += 1
        c, s = math.cos(fit[0]), math.sin(fit[0])
        first, last = lines.ends[j, 0], lines.ends[j, 1]
        a, b = points[first, 1] * c - points[first, 0] * s, points[last, 1] * c - points[last, 0] * s
        if abs(b - a) >= _MIN_LENGTH_M:
            _write(walls[w], 0, fit)
            walls[w, 5], walls[w, 6] = min(a, b), max(a, b)
            w += 1
    return walls[:w].copy(), found[:e].copy()
