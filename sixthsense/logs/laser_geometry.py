"""What scans say of the laser that took them: its beams, its mount on the robot and its maximum range."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan

FARTHEST_M, MOST_BEAMS = 1000.0, 100_000
"""maximum range and number of beams of a laser that a configuration allows"""
_MOUNT_SPREAD_M, _MOUNT_SPREAD_RAD = 0.01, math.radians(0.5)
"""Rounding of poses to two decimals gives less; poses that were corrected by a scan matcher differ by more."""
_MOUNT_LARGEST_M = 10.0
_SPREAD_PERCENTILE = 95.0

_CODES_FROM = 0.998
"""Share of the greatest reading from which readings are codes: a SICK LMS 200 has 8183 to 8191."""
_BELOW_CODES = 0.9
"""Share of the greatest reading from which readings are compared with the codes."""
_CODE_RATIO = 10
"""A code is this many times as frequent as any reading below it."""
_CODE_SCANS, _CODE_BEAMS = 10, 5
"""Fewest scans and beams with a code: a wall that a standing robot sees repeats in few beams."""


class Beams(NamedTuple):
    """Evenly spaced beams of a scan."""

    first: float
    """bearing of the first beam in the laser's frame, rad"""
    step: float
    """between two beams, rad"""


_FIELDS = tuple(math.radians(degrees) for degrees in (240.0, 270.0, 360.0))
"""of lasers in use, beside half a turn"""
_FINE_STEP = 2.0 * math.pi / 1024.0  # rad between beams of a Hokuyo URG


def beams_by_count(count: int) -> tuple[Beams, ...]:
    """The beams that a FLASER line may have, which states only their number; the first is a scanner of 180 degrees.

    An odd number includes both ends (181: one degree apart), an even one leaves out the last (180: one degree, 360:
    half a degree). CARMEN itself reads its logs so.
    """
    fields = [fov for fov in (_FINE_STEP * (count - 1), *_FIELDS) if math.pi * 1.05 < fov < 2.0 * math.pi + 1e-6]
    apart = [fov for k, fov in enumerate(fields) if all(abs(fov - other) > 0.02 * fov for other in fields[:k])]
    return Beams(-math.pi / 2.0, math.pi / (count - count % 2)), *(beams_over(fov, count) for fov in apart)


def beams_over(fov: float, count: int) -> Beams:
    """`count` beams over a stated field of view, rad, centred; a full circle has no beam that repeats the first."""
    full = fov > 2.0 * math.pi - 1e-6
    return Beams(-fov / 2.0, fov / (count if full else count - 1))


def beams_as_stated(count: int, start: float, fov: float, resolution: float) -> Beams:
    """The beams of a ROBOTLASER1 line, rad; the field of view decides where the resolution contradicts it."""
    agrees = resolution > 0.0 and abs(resolution * (count - 1) - fov) <= 1.5 * resolution
    return Beams(start, resolution if agrees else beams_over(fov, count).step)


def with_beams(scan: Scan, first: float, step: float) -> Scan:
    """The scan with beams that begin at a bearing, and are a step apart, rad."""
    return replace(scan, angle_min=np.float32(first), angle_increment=np.float32(step))


def mount_from_poses(laser: Array, robot: Array) -> Pose | None:
    """`T_robot_laser` from poses (N, 3) of the laser and of the robot in one frame: the median over all scans.

    None if the two do not move as one body: then the laser's pose is not odometry, but corrected by a scan matcher.
    """
    dx, dy = (laser[:, :2] - robot[:, :2]).T
    c, s = np.cos(robot[:, 2]), np.sin(robot[:, 2])
    x, y = c * dx + s * dy, c * dy - s * dx
    turn = wrap_angle(laser[:, 2] - robot[:, 2])
    turn = turn[0] + wrap_angle(turn - turn[0])  # a laser that looks back has turns of both signs
    place = np.array([np.median(x), np.median(y), np.median(turn)])
    spread_m = np.percentile(np.hypot(x - place[0], y - place[1]), _SPREAD_PERCENTILE)
    spread_rad = np.percentile(np.abs(turn - place[2]), _SPREAD_PERCENTILE)
    if spread_m > _MOUNT_SPREAD_M or spread_rad > _MOUNT_SPREAD_RAD or np.hypot(*place[:2]) > _MOUNT_LARGEST_M:
        return None
    return Pose(*place.round(6))  # the decimals that CARMEN writes


def no_return_code(scans: Sequence[NDArray[np.float32]]) -> float | None:
    """The range, m, from which the readings of (N,) scans are codes for "no return"; None if there is no such code.

    A laser that reports its maximum for a beam without a return repeats one value at the top of the distribution, in
    many scans and beams, with next to nothing below it; a wall does not.
    """
    top = greatest_range(scans)
    if top <= 0.0:
        return None
    code_from = np.float32(math.floor(_CODES_FROM * top * 100.0) / 100.0)
    near = [scan[(scan >= np.float32(_BELOW_CODES * top)) & np.isfinite(scan)] for scan in scans]
    beams = [found for scan in scans if len(found := np.flatnonzero((scan >= code_from) & np.isfinite(scan)))]
    if len(beams) < _CODE_SCANS or len(np.unique(np.concatenate(beams))) < _CODE_BEAMS:
        return None
    values, counts = np.unique(np.concatenate(near), return_counts=True)
    is_code = values >= code_from
    return float(code_from) if counts[is_code].max() >= _CODE_RATIO * counts[~is_code].max(initial=1) else None


def max_range_of(scans: Sequence[NDArray[np.float32]]) -> float:
    """The maximum range, m, of a laser that does not state it: its code for no return, else above all its ranges."""
    code = no_return_code(scans)
    above = np.nextafter(np.float32(greatest_range(scans)), np.float32(np.inf))
    return min(float(above) if code is None else code, FARTHEST_M)


def greatest_range(scans: Sequence[NDArray[np.float32]]) -> float:
    """The greatest finite reading of (N,) scans, m; 0 without one."""
    return max((float(scan[np.isfinite(scan)].max(initial=0.0)) for scan in scans), default=0.0)
