"""Gaps between neighbouring returns of one straight wall, which a robot need not look into.

The reciprocal of the range to a straight wall is cos(bearing - normal) / distance. So three returns are of one wall if
the middle one's reciprocal is what this gives for its two neighbours. Of a wall at a grazing angle returns are farther
apart than the cells of a map, and what lies between them would count as unseen.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.config.sections import LaserNoise
from sixthsense.core.covariance import SIGNIFICANT
from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan


def straight_gaps(scan: Scan, noise: LaserNoise, shortest_m: float, longest_m: float) -> Array:
    """(W, 2, 2) the gaps of one wall whose length is between two limits, robot frame, metres."""
    ranges = np.where(scan.ranges < scan.max_range, scan.ranges, np.nan).astype(np.float64)
    gaps = _straight_gaps(
        ranges, scan.bearings, scan.closed, (noise.range_m, noise.bearing_rad), (shortest_m, longest_m)
    )
    return np.asarray(scan.T_robot_laser @ gaps)


@numba.njit(cache=True, error_model="numpy")
def _straight_gaps(
    ranges: Array, bearings: Array, closed: bool, sigmas: tuple[float, float], limits: tuple[float, float]
) -> Array:
    """The gaps in the laser's frame; `ranges` (N,) are NaN without a return, and `closed` scans have no ends."""
    n = len(ranges)
    is_straight = np.zeros(n, dtype=np.bool_)  # whether a return and its two neighbours are of one wall
    for i in range(n):
        a, c = (i - 1) % n, (i + 1) % n
        if not closed and (i == 0 or i == n - 1):
            continue
        if not (ranges[a] > 0.0 and ranges[i] > 0.0 and ranges[c] > 0.0):
            continue
        before, after = (bearings[i] - bearings[a]) % (2.0 * math.pi), (bearings[c] - bearings[i]) % (2.0 * math.pi)
        if before + after >= math.pi:
            continue
        share_a, share_c = math.sin(after) / math.sin(before + after), math.sin(before) / math.sin(before + after)
        q_a, q, q_c = 1.0 / ranges[a], 1.0 / ranges[i], 1.0 / ranges[c]
        slope = (q_c - q_a) / (before + after)
        variance = 0.0
        for weight, value in ((share_a, q_a), (1.0, q), (share_c, q_c)):
            variance += weight * weight * ((sigmas[0] * value * value) ** 2 + (sigmas[1] * slope) ** 2)
        is_straight[i] = abs(share_a * q_a + share_c * q_c - q) <= SIGNIFICANT * math.sqrt(variance)
    gaps = np.empty((n, 2, 2))
    count = 0
    for i in range(n if closed else n - 1):
        j = (i + 1) % n
        if not (is_straight[i] or is_straight[j]):
            continue
        for end, k in ((0, i), (1, j)):
            gaps[count, end, 0] = ranges[k] * math.cos(bearings[k])
            gaps[count, end, 1] = ranges[k] * math.sin(bearings[k])
        length = math.hypot(gaps[count, 1, 0] - gaps[count, 0, 0], gaps[count, 1, 1] - gaps[count, 0, 1])
        count += limits[0] < length < limits[1]
    return gaps[:count].copy()
