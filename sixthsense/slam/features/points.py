"""Point landmarks of a scan: corners of neighbouring walls and free ends, with covariances from the line fits.

Each laser return is evidence once: a wall with a landmark at both ends feeds each from the half of its returns on that
side, so that the two are independent; a wall with one landmark feeds it from all its returns.
"""

from __future__ import annotations

import numba
import numpy as np

from sixthsense.core.geometry import Array
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
from sixthsense.slam.features.line_fit import LaserSigmas, fit_line
from sixthsense.slam.features.lines import FittedLines
from sixthsense.slam.features.partition import Indices

CORNER, END = 0, 1
"""Values of `Kind`, which compiled code cannot read."""


@numba.njit(cache=True, error_model="numpy")
def _fit_sides(
    points: Array, lines: FittedLines, endpoint_type: Indices, sigmas: LaserSigmas
) -> tuple[Array, Indices, Indices]:
    """(L, 2, 5) fits of each line for the landmark at its first and at its last return; NaN where there is none.

    The two fits of a line share no return. Also returns (U,) the returns of all lines, and (L, 2, 2) first and
    past-last place in that array of those of each fit.
    """
    sides = np.full((len(lines.fits), 2, 5), np.nan)
    used, u = np.empty(len(lines.owner), np.int64), 0
    of_sides = np.zeros((len(lines.fits), 2, 2), np.int64)
    for j in range(len(lines.fits)):
        owned = np.flatnonzero(lines.owner == j)
        owned = clear_of_corners(points, owned, j, lines.fits, endpoint_type, sigmas.range_m)
        both = endpoint_type[j, 0] != UNDECIDED and endpoint_type[j, 1] != UNDECIDED
        middle = len(owned) // 2 if both else -1
        used[u : u + len(owned)] = owned
        for side in range(2):
            half = owned
            if middle >= 0:
                half = owned[:middle] if side == 0 else owned[middle:]
            begin = u + (middle if middle >= 0 and side == 1 else 0)
            of_sides[j, side] = begin, begin + len(half)
            if endpoint_type[j, side] != UNDECIDED and len(half) >= 3:
                sides[j, side] = fit_line(points, half, sigmas.range_m, sigmas.bearing_rad)
        u += len(owned)
    return sides, used[:u], of_sides


@numba.njit(cache=True, error_model="numpy")
def _append(used: Indices, u: int, returns: Indices, span: Indices) -> int:
    """Copy `returns` from the first to before the last index in `span` (2,) to `used` at `u`; returns the next u."""
    count: int = span[1] - span[0]
    used[u : u + count] = returns[span[0] : span[1]]
    return u + count


@numba.njit(cache=True, error_model="numpy")
def find_points(
    scan: RolledScan, lines: FittedLines, rules: EndpointRules, sigmas: LaserSigmas
) -> tuple[Indices, Array, Indices, Indices]:
    """Corners and free ends of one scan.

    Returns (K,) kinds; (K, 5) x, y, xx, xy, yy in the laser's frame, metres; (U,) the returns that were used; and
    (K, 2) first and past-last place in that array of those of each point.
    """
    count, spacing = len(lines.fits), mean_spacing(scan.bearings)
    endpoint_type = np.full((count, 2), UNDECIDED, np.int64)
    if rules.corners:
        mark_corners(scan, lines, rules, endpoint_type)
    if rules.ends:
        mark_free_ends(scan, lines, rules, endpoint_type)
    sides, of_lines, of_sides = _fit_sides(scan.points, lines, endpoint_type, sigmas)
    kinds = np.empty(2 * count, np.int64)
    found = np.empty((2 * count, 5))
    used, of_points = np.empty(len(of_lines), np.int64), np.empty((2 * count, 2), np.int64)
    k = u = 0
    for j in range(count):
        if endpoint_type[j, 1] >= 0:
            after = endpoint_type[j, 1]
            kinds[k], found[k] = CORNER, intersect(sides[j, 1], sides[after, 0])
            begin = u
            u = _append(used, u, of_lines, of_sides[j, 1])
            u = _append(used, u, of_lines, of_sides[after, 0])
            of_points[k] = begin, u
            k += 1
        for side, step in ((0, -spacing), (1, spacing)):
            if endpoint_type[j, side] == FREE_END:
                bearing = scan.bearings[lines.ends[j, side]]
                kinds[k], found[k] = END, free_end(sides[j, side], bearing, step, sigmas.bearing_rad)
                begin = u
                u = _append(used, u, of_lines, of_sides[j, side])
                of_points[k] = begin, u
                k += 1
    return kinds[:k].copy(), found[:k].copy(), used[:u].copy(), of_points[:k].copy()
