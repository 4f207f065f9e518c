"""Gaps between neighbouring returns of one straight wall, which a robot need not look into.

The reciprocal of the range to a straight wall is cos(bearing - normal) / distance. So three returns are of one wall if
the middle one's reciprocal is what this gives for its two neighbours. Of a wall at a grazing angle returns are farther
apart than the cells of a map, and what lies between them would count as unseen. A gap through which no robot fits is
closed. Along the beams it may be longer, if the wall goes on at both ends: there a gap of a robot's radius across them
is several robots long, and a robot that looks along a wall would drive up to each of its gaps.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.config.sections import LaserNoise
from sixthsense.core.covariance import SIGNIFICANT
from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan

_ALONG = 12.0
"""radii of the robot: a longer gap stays open, however narrow it is across the beams"""


def straight_gaps(scan: Scan, noise: LaserNoise, shortest_m: float, radius_m: float) -> Array:
    """(W, 2, 2) the gaps of one wall that are longer than a limit and no way for a robot, robot frame, metres."""
    ranges = np.where(scan.is_return, scan.ranges.astype(np.float64), np.nan)
    # Of each return and its neighbours before and after, those of a closed scan around its end.
    bearings, following = scan.bearings, np.arange(1, len(ranges) + 1) % len(ranges)
    preceding = (following - 2) % len(ranges)
    after = (bearings[following] - bearings) % math.tau
    if not scan.closed:
        after[-1] = math.pi
    before, q = after[preceding], 1.0 / ranges
    q_before, q_after = q[preceding], q[following]
    with np.errstate(divide="ignore", invalid="ignore"):
        sines, both = np.sin(after), np.sin(before + after)
        share_before, share_after = sines / both, sines[preceding] / both
        slope = (q_after - q_before) / (before + after)
        variance = np.zeros(len(q))
        for weight, value in ((share_before, q_before), (1.0, q), (share_after, q_after)):
            variance += weight * weight * ((noise.range_m * value * value) ** 2 + (noise.bearing_rad * slope) ** 2)
        off = np.abs(share_before * q_before + share_after * q_after - q)
        is_straight = (before + after < math.pi) & (off <= SIGNIFICANT * np.sqrt(variance))
        gaps = np.stack([scan.points_robot, scan.points_robot[following]], axis=1)
        length = np.linalg.norm(gaps[:, 1] - gaps[:, 0], axis=1)
    across = np.fmin(ranges, ranges[following]) * sines
    is_certain = is_straight & is_straight[following] & (across < radius_m)
    longest = np.where(is_certain, _ALONG * radius_m, 2.0 * radius_m)
    is_gap = (is_straight | is_straight[following]) & (after < math.pi) & (shortest_m < length) & (length < longest)
    return np.asarray(gaps[is_gap])
