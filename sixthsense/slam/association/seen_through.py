"""How much of known walls a scan sees, and how much of them it sees through: a laser sees nothing beyond a wall.

Observations tell which landmarks are there, and not which are missing. Where the pose is uncertain, a piece of wall
that stands out from a longer one passes the gate of this; with the match the robot would see through the rest of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.association.observed import WALL_GAP_M, offset_variance

_SIGMAS = 2.0
"""of the place along a wall"""
_BEHIND, _ON, _BEFORE = range(3)  # where a return is


class Returns(NamedTuple):
    """The n returns of a scan, in the order of its beams, robot's frame, m."""

    laser: Array
    """(2,) where the laser is"""
    points: Array
    """(n, 2)"""


def offset_variances(lines: Array, covs: Array, places: Array) -> Array:
    """(k,) variance of the offsets, m, of walls `lines` (k, 2) with `covs` (k, 2, 2), at `places` (k, 2) on them."""
    along = places[:, 1] * np.cos(lines[:, 0]) - places[:, 0] * np.sin(lines[:, 0])
    return np.array([offset_variance(cov, place) for cov, place in zip(covs, along, strict=True)])


@numba.njit(cache=True, error_model="numpy")
def lengths_seen(returns: Returns, lines: Array, covs: Array, extents: Array, along_m: float, gate: float) -> Array:
    """(k, 2, 3) length, m, of the known extent of each wall that the scan sees through, and that it sees.

    Of each there are three, for three places along the line, since the sigma of this is `along_m`. `lines` (k, 2) are
    angle of the normal and offset, with `covs` (k, 2, 2); `extents` (k, 2, 2) are both ends; all in the robot's frame.
    A return farther than `gate` variances and the noise of ends is behind the wall, or before it, and else on it. The
    length is that between the crossings of neighbouring beams.
    """
    out = np.zeros((len(lines), 2, 3))
    for j in range(len(lines)):
        c, s = math.cos(lines[j, 0]), math.sin(lines[j, 0])
        first, last = c * extents[j, 0, 1] - s * extents[j, 0, 0], c * extents[j, 1, 1] - s * extents[j, 1, 0]
        low, high = min(first, last), max(first, last)
        across = c * returns.laser[0] + s * returns.laser[1] - lines[j, 1]
        along = c * returns.laser[1] - s * returns.laser[0]
        was, crossing_before = _BEFORE, 0.0
        for i in range(len(returns.points)):
            x, y = returns.points[i, 0], returns.points[i, 1]
            beyond, is_now, crossing = c * x + s * y - lines[j, 1], _BEFORE, c * y - s * x
            limit = max(gate * offset_variance(covs[j], crossing), WALL_GAP_M**2)
            if beyond * beyond <= limit:
                is_now = _ON
            elif beyond * across < 0.0:
                is_now = _BEHIND
                crossing = along + (crossing - along) * across / (across - beyond)
            if is_now == was and is_now != _BEFORE:
                left, right = min(crossing_before, crossing), max(crossing_before, crossing)
                for k in range(3):
                    shift = (k - 1) * _SIGMAS * along_m
                    out[j, is_now, k] += max(min(right, high + shift) - max(left, low + shift), 0.0)
            was, crossing_before = is_now, crossing
    return out
