"""What scans say of the laser that took them: its beams, its mount on the robot and its maximum range."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between

FARTHEST_M, MOST_BEAMS = 1000.0, 100_000
"""maximum range and number of beams of a laser that a configuration allows"""
_ONE_BODY = (0.01, 0.01, math.radians(0.5))
"""m, rad: rounding of poses to two decimals gives less; poses that were corrected by a scan matcher differ by more"""
_LARGEST_M = 10.0  # of a mount
_CODES_FROM, _BELOW = 0.998, 0.9
"""shares of the greatest reading from which readings are codes (8183 to 8191 of a SICK LMS 200), and compared with
them"""
_CODE_RATIO = 10
"""A code is this many times as frequent as any reading below it, and in as many scans or more."""
_CODE_BEAMS = 5
"""fewest beams with a code: a wall that a standing robot sees repeats in few beams"""
_FIELDS = tuple(math.radians(degrees) for degrees in (240.0, 270.0, 360.0))
"""fields of view of lasers in use, beside half a turn"""
_FINE_STEP = 2.0 * math.pi / 1024.0  # rad between beams of a Hokuyo URG


class Beams(NamedTuple):
    """Evenly spaced beams of a scan."""

    first: float
    """bearing of the first beam in the laser's frame, rad"""
    step: float
    """between two beams, rad"""


@functools.cache
def beams_by_count(count: int) -> tuple[Beams, ...]:
    """The beams that a FLASER line may have, which states only their number; the first is a scanner of 180 degrees.

    An odd number includes both ends (181: one degree apart), an even one leaves out the last (180: one degree, 360:
    half a degree). CARMEN itself reads its logs so.
    """
    fields = [math.pi, *(fov for fov in (_FINE_STEP * (count - 1), *_FIELDS) if math.pi < fov <= 2.0 * math.pi)]
    apart = [fov for k, fov in enumerate(fields) if all(abs(fov - other) > 0.02 * fov for other in fields[:k])][1:]
    return Beams(-math.pi / 2.0, math.pi / (count - count % 2)), *(beams_over(fov, count) for fov in apart)


def beams_over(fov: float, count: int) -> Beams:
    """`count` beams over a stated field of view, rad, centred; a full circle has no beam that repeats the first."""
    full = fov > 2.0 * math.pi - 1e-6
    return Beams(-fov / 2.0, fov / (count if full else count - 1))


def with_beams(scan: Scan, beams: Beams) -> Scan:
    """The scan with these beams."""
    return replace(scan, angle_min=np.float32(beams.first), angle_increment=np.float32(beams.step))


def mount_from_poses(laser: Array, robot: Array) -> Pose | None:
    """`T_robot_laser` from poses (N, 3) of the laser and of the robot in one frame: the median over all scans.

    None if the two do not move as one body: then the laser's pose is not odometry, but corrected by a scan matcher.
    """
    mounts = between(robot, laser)
    mounts[:, 2] = mounts[0, 2] + wrap_angle(mounts[:, 2] - mounts[0, 2])  # one that looks back has turns of both signs
    place = np.median(mounts, axis=0)
    spread = np.percentile(np.abs(mounts - place), 95, axis=0)
    if (spread > _ONE_BODY).any() or np.hypot(*place[:2]) > _LARGEST_M:
        return None
    return Pose(*place.round(6))  # the decimals that CARMEN writes


def no_return_code(scans: Sequence[NDArray[np.float32]]) -> float | None:
    """The range, m, from which the readings of (N,) scans are codes for "no return"; None if there is no such code.

    A laser that reports its maximum for a beam without a return repeats one value at the top of the distribution, in
    many scans and beams, with next to nothing below it; a wall does not.
    """
    top = greatest_range(scans)
    code_from = np.float32(math.floor(_CODES_FROM * top * 100.0) / 100.0)
    beams = [found for scan in scans if len(found := np.flatnonzero((scan >= code_from) & np.isfinite(scan)))]
    if top <= 0.0 or len(beams) < _CODE_RATIO or len(np.unique(np.concatenate(beams))) < _CODE_BEAMS:
        return None
    near = [scan[(scan >= np.float32(_BELOW * top)) & np.isfinite(scan)] for scan in scans]
    values, counts = np.unique(np.concatenate(near), return_counts=True)
    most, below = counts[values >= code_from].max(), counts[values < code_from].max(initial=1)
    return float(code_from) if most >= _CODE_RATIO * below else None


def max_range_of(scans: Sequence[NDArray[np.float32]]) -> float:
    """The maximum range, m, of a laser that does not state it: its code for no return, else above all its ranges."""
    above = float(np.nextafter(np.float32(greatest_range(scans)), np.float32(np.inf)))
    return min(no_return_code(scans) or above, FARTHEST_M)


def greatest_range(scans: Sequence[NDArray[np.float32]]) -> float:
    """The greatest finite reading of (N,) scans, m; 0 without one."""
    return max((float(scan[np.isfinite(scan)].max(initial=0.0)) for scan in scans), default=0.0)
