"""Known walls that the returns of a scan lie behind: a laser sees nothing beyond a wall.

Observations tell which landmarks are there, and not which are missing. Where the pose is uncertain, a piece of wall
that stands out from a longer one passes the gate of this; with the match the robot would see through the rest of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.association.observed import WALL_GAP_M

_SIGMAS = 2.0
"""of the place along a wall: the scan sees through it wherever between these the robot is"""


class Returns(NamedTuple):
    """The n returns of a scan, in the order of its beams, robot's frame, m."""

    laser: Array
    """(2,) where the laser is"""
    points: Array
    """(n, 2)"""


def offset_variances(lines: Array, covs: Array, places: Array) -> Array:
    """(k,) variance of the offsets, m, of walls `lines` (k, 2) with `covs` (k, 2, 2), at `places` (k, 2) on them."""
    along = places[:, 1] * np.cos(lines[:, 0]) - places[:, 0] * np.sin(lines[:, 0])
    return np.asarray(covs[:, 1, 1] + along * (along * covs[:, 0, 0] - 2.0 * covs[:, 0, 1]))


@numba.njit(cache=True, error_model="numpy")
def lengths_seen_through(
    returns: Returns, lines: Array, covs: Array, extents: Array, along_m: float, gate: float
) -> Array:
    """(k,) least length, m, of the known extent of each wall that lies between the laser and returns behind it.

    `lines` (k, 2) are angle of the normal and offset, with `covs` (k, 2, 2); `extents` (k, 2, 2) are both ends, whose
    place along the line has a sigma of `along_m`. All are in the robot's frame. A return is behind a wall if its
    squared distance exceeds `gate` variances, and its distance the noise of ends. The length is that between the
    crossings of neighbouring beams.
    """
    out = np.zeros(len(lines))
    for j in range(len(lines)):
        c, s = math.cos(lines[j, 0]), math.sin(lines[j, 0])
        first, last = c * extents[j, 0, 1] - s * extents[j, 0, 0], c * extents[j, 1, 1] - s * extents[j, 1, 0]
        low, high = min(first, last), max(first, last)
        across = c * returns.laser[0] + s * returns.laser[1] - lines[j, 1]
        along = c * returns.laser[1] - s * returns.laser[0]
        lengths, was_behind, before = np.zeros(3), False, 0.0
        for i in range(len(returns.points)):
            x, y = returns.points[i, 0], returns.points[i, 1]
            beyond, is_behind, crossing = c * x + s * y - lines[j, 1], False, 0.0
            if beyond * across < 0.0:
                crossing = along + (c * y - s * x - along) * across / (across - beyond)
                variance = covs[j, 1, 1] + crossing * (crossing * covs[j, 0, 0] - 2.0 * covs[j, 0, 1])
                is_behind = beyond * beyond > max(gate * variance, WALL_GAP_M**2)
            if is_behind and was_behind:
                left, right = min(before, crossing), max(before, crossing)
                for k in range(3):
                    shift = (k - 1) * _SIGMAS * along_m
                    lengths[k] += max(min(right, high + shift) - max(left, low + shift), 0.0)
            was_behind, before = is_behind, crossing
        out[j] = lengths.min()
    return out
