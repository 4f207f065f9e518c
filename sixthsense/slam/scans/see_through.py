"""The see-through test: whether two scans at a relative pose contradict each other.

A return of one scan contradicts the other scan where that has seen through the place of the return.
"""

from __future__ import annotations

import math

import numba

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.bearings import cell_of, direction
from sixthsense.slam.scans.scan_store import Returns

_TOLERANCE_M = 0.12  # between returns of one surface


@numba.njit(cache=True, error_model="numpy")
def compare_views(returns: Returns, target: int, source: int, pose: Array) -> tuple[int, int, int]:
    """How many returns of `source` lie on a return of `target`, how many where it has seen through, and how many are.

    `pose` (3,) is that of the source in the target's frame. Each return is compared with three neighbouring beams.
    """
    points, bearings = returns.points, returns.bearings
    c, s = math.cos(pose[2]), math.sin(pose[2])
    hits = violations = count = 0
    for k in range(0, bearings.beams, bearings.stride):
        if points[source, k, 2] == 0.0:
            continue
        count += 1
        x = pose[0] + c * points[source, k, 0] - s * points[source, k, 1]
        y = pose[1] + s * points[source, k, 0] + c * points[source, k, 1]
        distance = math.sqrt(x * x + y * y)
        centre = math.floor(cell_of(bearings, direction(x, y)) + 0.5)
        if not bearings.closed and (centre < 1 or centre >= bearings.beams - 1):
            continue
        gap, shortest = math.inf, math.inf
        for beam in range(centre - 1, centre + 2):
            q = beam % bearings.beams
            r = points[target, q, 2]
            if r > 0.0:
                dx, dy = x - points[target, q, 0], y - points[target, q, 1]
                gap = min(gap, math.sqrt(dx * dx + dy * dy), abs(distance - r))
                shortest = min(shortest, r)
        if gap < _TOLERANCE_M:
            hits += 1
        elif shortest < math.inf and distance < shortest - 2.0 * _TOLERANCE_M:
            violations += 1
    return hits, violations, count
