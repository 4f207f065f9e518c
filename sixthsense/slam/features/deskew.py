"""De-skewing: a scan takes time while the robot moves; its returns are moved to where the robot is at its end.

Beam i of a sweep is taken from the robot's pose at its own time, which odometry knows relative to that at the scan's
stamp: over a tenth of a second its error is far below the laser's. What comes out is a scan taken at an instant, as all
that follows expects, but for its bearings, which are no longer evenly spaced. Beams are taken to start from the laser
at the scan's stamp: right for where they end, and for the cells that they cross off by the robot's own motion, which is
free space.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import deque

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, Sweep
from sixthsense.core.motion import STANDSTILL, Odometry

LONGEST_SWEEP_NS = 1_000_000_000
"""No sweep takes longer."""


class Deskewer:
    """Keeps the odometry of the last ticks, and moves scans to their end by it."""

    def __init__(self, enabled: bool = True) -> None:
        """With `enabled` off scans stay as they are."""
        self._enabled = enabled
        self._ticks: deque[tuple[int, Odometry]] = deque()  # stamps, and the motion since the tick before

    def moved(self, stamp_ns: int, increment: Odometry) -> None:
        """Take in a tick, and the motion since the one before; stamps ascend."""
        self._ticks.append((stamp_ns, increment))
        # One tick at or before the longest sweep's begin is enough.
        while len(self._ticks) > 2 and self._ticks[1][0] <= stamp_ns - LONGEST_SWEEP_NS:
            self._ticks.popleft()

    def __call__(self, scan: Scan) -> Scan:
        """The scan as if taken at the instant of the latest tick; a scan that took no time is returned as it is."""
        if not self._enabled or scan.time_increment == 0.0 or not self._ticks:
            return scan
        mount, times_s = scan.T_robot_laser, scan.times_s
        stamps_s, track, whole = self._track(float(times_s.min()))
        poses = interpolated(stamps_s, track, times_s)  # (N, 3) of the robot, seen from its last
        ranges, bearings = _moved(scan.ranges, scan.bearings, poses, mount.x, mount.y, mount.theta)
        kept, closed = _once(scan.bearings + poses[:, 2], scan) if scan.closed else (slice(None), False)
        ranges, lags = ranges[kept], times_s[kept] / stamps_s[0] if len(stamps_s) > 1 else 0.0 * times_s[kept]
        ranges.flags.writeable = False
        sweep = Sweep(bearings[kept], closed, whole.cov_after(), lags)
        return dataclasses.replace(scan, ranges=ranges, time_increment=np.float32(0.0), sweep=sweep)

    def _track(self, begin_s: float) -> tuple[Array, Array, Odometry]:
        """Stamps (K,), 0 at the latest tick, back to `begin_s`, the robot's poses then, and the motion in all."""
        end_ns = self._ticks[-1][0]
        stamps_s, poses, whole = [0.0], [Pose().array()], STANDSTILL
        for (_, increment), (stamp_ns, _) in itertools.pairwise(reversed(self._ticks)):
            whole = increment.then(whole)
            stamps_s.append(1e-9 * (stamp_ns - end_ns))
            poses.append(whole.motion.inverse().array())
            if stamps_s[-1] <= begin_s:
                break
        return np.array(stamps_s[::-1]), np.array(poses[::-1]), whole


def _once(directions: Array, scan: Scan) -> tuple[slice, bool]:
    """The beams of a full circle without those that a turning robot took a second time, and whether it still is one.

    `directions` (N,) of the beams as seen at the end, ascending. Of what was swept twice the later beams are kept; what
    was not swept at all is a gap, across which nothing is known to be connected.
    """
    spacing, circle = float(scan.angle_increment), 2.0 * math.pi
    first, past = 0, len(directions)
    if scan.time_increment > 0.0:
        first = int(np.searchsorted(directions, directions[-1] - circle + 0.5 * spacing))
    else:
        past = int(np.searchsorted(directions, directions[0] + circle - 0.5 * spacing))
    gap = directions[first] + circle - directions[past - 1]
    return slice(first, past), bool(gap < 1.5 * spacing)


@numba.njit(cache=True, error_model="numpy")
def _moved(
    ranges: NDArray[np.float32], bearings: Array, poses: Array, mx: float, my: float, mtheta: float
) -> tuple[NDArray[np.float32], Array]:
    """Ranges and bearings (N,) of the beams' ends seen from the laser at the end, `poses` (N, 3) of the robot there.

    The laser stands at (mx, my, mtheta) on the robot. Bearings are unwrapped: within half a turn of what they were.
    """
    out, angles = np.empty(len(ranges), np.float32), np.empty(len(ranges))
    c_mount, s_mount = math.cos(mtheta), math.sin(mtheta)
    for i in range(len(ranges)):
        r, theta = float(ranges[i]), poses[i, 2]
        angle = bearings[i] + mtheta
        if not (0.0 < r < np.inf):  # no place to move, but a direction to turn
            out[i], angles[i] = ranges[i], bearings[i] + theta
            continue
        bx, by = mx + r * math.cos(angle), my + r * math.sin(angle)
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = poses[i, 0] + c * bx - s * by - mx, poses[i, 1] + s * bx + c * by - my
        x, y = c_mount * dx + s_mount * dy, c_mount * dy - s_mount * dx
        out[i] = math.hypot(x, y)
        angles[i] = bearings[i] + (math.atan2(y, x) - bearings[i] + math.pi) % (2.0 * math.pi) - math.pi
    return out, angles
