"""De-skewing: a scan takes time while the robot moves; its returns are transformed to the laser's pose at its stamp.

Beam i of a sweep starts from the robot's pose at the beam's own time. Odometry gives that pose relative to the one at
the scan's stamp; over a tenth of a second its error is far below the laser's. The result is a scan of one instant, with
bearings that are no longer evenly spaced. Its beams start at the laser's pose at the stamp. This is exact for their
ends; the cells that they cross are off by the robot's own motion, through free space.

The motion from a beam's time to the scan's stamp is as uncertain as odometry is over that lag: a random walk, whose
covariance grows with the lag. All observations of a scan share that error, but an estimator takes them as independent:
with F of them the pose would be overconfident by a factor of F. So the share of each is multiplied by F.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import deque
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.landmarks import Observation, initialize_landmark, line_point
from sixthsense.core.laser import Scan, Sweep
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.se2 import Triple
from sixthsense.core.source import seconds

LONGEST_SWEEP_NS = 1_000_000_000
"""Longest duration of a sweep."""


class Deskewer:
    """De-skews scans by the odometry of the last ticks, which it keeps."""

    def __init__(self, enabled: bool = True) -> None:
        """With `enabled` off scans stay as they are."""
        self._enabled = enabled
        self._ticks: deque[tuple[int, Odometry]] = deque()
        """stamps, and the motion since the tick before"""

    def moved(self, stamp_ns: int, increment: Odometry) -> None:
        """Add a tick with the motion since the one before; stamps ascend."""
        self._ticks.append((stamp_ns, increment))
        # One tick at or before the begin of the longest sweep is enough.
        while len(self._ticks) > 2 and self._ticks[1][0] <= stamp_ns - LONGEST_SWEEP_NS:
            self._ticks.popleft()

    def __call__(self, scan: Scan) -> Scan:
        """The scan as if taken at the latest tick; of a scan without duration, or if this is off, a copy.

        A copy, so that a log does not keep the points of all of its scans.
        """
        if not self._enabled or scan.time_increment == 0.0 or not self._ticks:
            return dataclasses.replace(scan)
        mount, times_s = scan.T_robot_laser, scan.times_s
        stamps_s, track, whole = self._track(float(times_s.min()))
        poses = interpolated(stamps_s, track, times_s)  # (N, 3) of the robot, seen from its last
        ranges, bearings = _moved(scan.ranges, scan.bearings, poses, mount.triple())
        kept, closed = _without_overlap(scan.bearings + poses[:, 2], scan) if scan.closed else (slice(None), False)
        ranges, lags = ranges[kept], times_s[kept] / stamps_s[0] if len(stamps_s) > 1 else 0.0 * times_s[kept]
        ranges.flags.writeable = False
        sweep = Sweep(bearings[kept], closed, whole.cov, lags)
        return dataclasses.replace(scan, ranges=ranges, time_increment=np.float32(0.0), sweep=sweep)

    def _track(self, begin_s: float) -> tuple[Array, Array, Odometry]:
        """Stamps (K,), 0 at the latest tick, back to `begin_s`; the robot's poses (K, 3) then; the whole motion."""
        end_ns, _ = self._ticks[-1]
        stamps_s, poses, whole = [0.0], [Pose().array()], STANDSTILL
        for (_, increment), (stamp_ns, _) in itertools.pairwise(reversed(self._ticks)):
            whole = increment.then(whole)
            stamps_s.append(seconds(stamp_ns - end_ns))
            poses.append(whole.motion.inverse().array())
            if stamps_s[-1] <= begin_s:
                break
        return np.array(stamps_s[::-1]), np.array(poses[::-1]), whole


def add_sweep_noise(observations: Sequence[Observation], scan: Scan) -> tuple[Observation, ...]:
    """Observations (robot's frame) with the noise of the scan's sweep; unchanged where the scan was not de-skewed."""
    if scan.sweep is None or not observations:
        return tuple(observations)
    cov = len(observations) * scan.sweep.cov
    bearings = scan.bearings
    out = []
    for observation in observations:
        middle = 0.5 * (observation.extent[0] + observation.extent[1])
        seen = line_point(observation.z, middle) if observation.is_wall else observation.z
        x, y = scan.T_robot_laser.inverse() @ seen
        bearing = bearings[0] + (math.atan2(y, x) - bearings[0]) % (2.0 * math.pi)
        lag = float(np.interp(bearing, bearings, scan.sweep.lags))
        _, by_motion, _ = initialize_landmark(Pose(), observation)  # (2, 3) by a motion of the robot's frame
        out.append(dataclasses.replace(observation, cov=observation.cov + lag * by_motion @ cov @ by_motion.T))
    return tuple(out)


def _without_overlap(directions: Array, scan: Scan) -> tuple[slice, bool]:
    """The beams of a full circle without those that a turning robot took twice, and whether the circle is closed.

    `directions` (N,) of the beams as seen at the end, ascending. Of directions swept twice the later beams are kept.
    A sector that was not swept is a gap, which leaves the circle open.
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
    ranges: NDArray[np.float32], bearings: Array, poses: Array, mount: Triple
) -> tuple[NDArray[np.float32], Array]:
    """Ranges and bearings (N,) of the beams' ends at the laser's last pose; `poses` (N, 3) of the robot, from its last.

    The laser is mounted on the robot at `mount`. Bearings are within half a turn of the original ones.
    """
    out, angles = np.empty(len(ranges), np.float32), np.empty(len(ranges))
    mx, my, mtheta = mount
    c_mount, s_mount = math.cos(mtheta), math.sin(mtheta)
    for i in range(len(ranges)):
        r, theta = float(ranges[i]), poses[i, 2]
        angle = bearings[i] + mtheta
        if not (0.0 < r < np.inf):  # no end point: only the direction is rotated
            out[i], angles[i] = ranges[i], bearings[i] + theta
            continue
        bx, by = mx + r * math.cos(angle), my + r * math.sin(angle)
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = poses[i, 0] + c * bx - s * by - mx, poses[i, 1] + s * bx + c * by - my
        x, y = c_mount * dx + s_mount * dy, c_mount * dy - s_mount * dx
        out[i] = math.hypot(x, y)
        angles[i] = bearings[i] + (math.atan2(y, x) - bearings[i] + math.pi) % (2.0 * math.pi) - math.pi
    return out, angles
