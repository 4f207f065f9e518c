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
from sixthsense.slam.features.lines import FittedLines, LaserSigmas, fit_line
from sixthsense.slam.features.partition import Indices

CORNER, END = 0, 1
"""Values of `Kind`, which compiled code cannot read."""


@numba.njit(cache=True, error_model="numpy")
def _fit_sides(points: Array, lines: FittedLines, endpoint_type: Indices, sigmas: LaserSigmas) -> Array:
    """(L, 2, 5) fits of each line for the landmark at its first and at its last return; NaN where there is none.

    The two fits of a line share no return.
    """
    sides = np.full((len(lines.fits), 2, 5), np.nan)
    for j in range(len(lines.fits)):
        owned = np.flatnonzero(lines.owner == j)
        owned = clear_of_corners(points, owned, j, lines.fits, endpoint_type, sigmas.range_m)
        both = endpoint_type[j, 0] != UNDECIDED and endpoint_type[j, 1] != UNDECIDED
        middle = len(owned) // 2 if both else -1
        for side in range(2):
            half = owned
            if middle >= 0:
                half = owned[:middle] if side == 0 else owned[middle:]
            if endpoint_type[j, side] != UNDECIDED and len(half) >= 3:
                sides[j, side] = fit_line(points, half, sigmas.range_m, sigmas.bearing_rad)
    return sides


@numba.njit(cache=True, error_model="numpy")
def find_points(
    scan: RolledScan, lines: FittedLines, rules: EndpointRules, sigmas: LaserSigmas
) -> tuple[Indices, Array]:
    """Corners and free ends of one scan.

    Returns (K,) kinds and (K, 5) x, y, xx, xy, yy in the laser's frame, metres.
    """
    count, spacing = len(lines.fits), mean_spacing(scan.bearings)
    endpoint_type = np.full((count, 2), UNDECIDED, np.int64)
    if rules.corners:
        mark_corners(scan, lines, rules, endpoint_type)
    if rules.ends:
        mark_free_ends(scan, lines, rules, endpoint_type)
    sides = _fit_sides(scan.points, lines, endpoint_type, sigmas)
    kinds = np.empty(2 * count, np.int64)
    found = np.empty((2 * count, 5))
    k = 0
    for j in range(count):
        if endpoint_type[j, 1] >= 0:
            kinds[k], found[k] = CORNER, intersect(sides[j, 1], sides[endpoint_type[j, 1], 0])
            k += 1
        for side, step in ((0, -spacing), (1, spacing)):
            if endpoint_type[j, side] == FREE_END:
                bearing = scan.bearings[lines.ends[j, side]]
                kinds[k], found[k] = END, free_end(sides[j, side], bearing, step, sigmas.bearing_rad)
                k += 1
    return kinds[:k].copy(), found[:k].copy()
