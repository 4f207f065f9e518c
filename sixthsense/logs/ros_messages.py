"""ROS messages as stamps, planar poses, covariances and scans; ValueError for what is not allowed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.logs.laser_geometry import FARTHEST_M, MOST_BEAMS
from sixthsense.logs.text_lines import LARGEST, LAST_STAMP_S
from sixthsense.logs.units import SI, Units, check_bearings

ODOMETRY = "nav_msgs/msg/Odometry"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"

_PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw of x y z roll pitch yaw

_LARGEST_STAMP_NS = LAST_STAMP_S * 1_000_000_000
_LONGEST_SWEEP_S = 1.0
_LEAST_UPRIGHT = 0.9  # cosine of the largest tilt of a planar scan
_LONGER, _SHORTER, _CONTRADICTS = 1.1, 0.25, 1.2  # of a sweep beside its period or scan_time; and of spans of angles


def stamp_ns(message: Any) -> int:
    """The stamp of the header, nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def checked_stamp(where: str, stamp_ns: int) -> int:
    """A stamp that fits into 64 bits; InputError about `where` for any other."""
    if not 0 <= stamp_ns <= _LARGEST_STAMP_NS:
        raise InputError(where, f"found stamp {stamp_ns} ns", f"0 to {_LARGEST_STAMP_NS} ns")
    return stamp_ns


def frame_name(name: str) -> str:
    """The name of a frame without the leading slash of ROS 1."""
    return str(name).lstrip("/")


def planar(position: Any, orientation: Any) -> Pose:
    """Position and quaternion projected onto the plane; exact for a rotation about z."""
    x, y, z, w = (float(v) for v in (orientation.x, orientation.y, orientation.z, orientation.w))
    values = (float(position.x), float(position.y), x, y, z, w)
    norm = math.hypot(x, y, z, w)
    if not (all(map(math.isfinite, (*values, norm))) and norm > 0.0):
        raise ValueError(f"found a pose of {values}, allowed: finite numbers and a quaternion that is not zero")
    if max(abs(values[0]), abs(values[1])) > LARGEST:
        raise ValueError(f"found a pose at ({values[0]}, {values[1]}), allowed: up to {LARGEST:.0e} m")
    if x == 0.0 and y == 0.0:
        return Pose(values[0], values[1], 2.0 * math.atan2(z, w))
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return Pose(values[0], values[1], math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def transform(message: Any) -> Array:
    """(4, 4) matrix of a geometry_msgs/Transform."""
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    r, t = message.rotation, message.translation
    q = np.array([r.x, r.y, r.z, r.w], dtype=np.float64)
    t_xyz = np.array([t.x, t.y, t.z], dtype=np.float64)
    norm = math.hypot(*q)  # without intermediate overflow
    if not (np.abs(t_xyz).max() <= LARGEST and math.isfinite(norm) and norm > 0.0):  # false for NaN
        raise ValueError(
            f"found a transform that is not finite, allowed: up to {LARGEST:.0e} m and a quaternion that is not zero"
        )
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(q / norm).as_matrix()
    out[:3, 3] = t_xyz
    return out


def planar_of(T: Array) -> Pose:
    """A (4, 4) matrix projected onto the plane; exact for a rotation about z."""
    return Pose(T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0]))


def mount(T_robot_laser: Array) -> tuple[Pose, bool]:
    """The planar mount of the laser from a (4, 4) matrix, and whether the laser is upside down."""
    if abs(T_robot_laser[2, 2]) < _LEAST_UPRIGHT:
        raise ValueError("found a laser tilted out of the plane, allowed: a level one")
    yaw = math.atan2(T_robot_laser[1, 0], T_robot_laser[0, 0])
    return Pose(T_robot_laser[0, 3], T_robot_laser[1, 3], yaw), bool(T_robot_laser[2, 2] < 0.0)


def stated_reach(message: Any, units: Units = SI) -> float | None:
    """The `range_max` of a LaserScan, m; None where it is not that of a laser: zero, infinite, or no number."""
    reach = float(np.float32(message.range_max)) * units.ranges
    return reach if 0.0 < reach <= FARTHEST_M else None


def ranges_of(message: Any, units: Units = SI) -> NDArray[np.float32]:
    """(N,) ranges, m, of a LaserScan, or the first echoes of a MultiEchoLaserScan; infinite without an echo."""
    rows: Any = message.ranges
    if len(rows) and hasattr(rows[0], "echoes"):
        rows = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in rows]
    ranges = np.asarray(rows, dtype=np.float32)
    return ranges if units.ranges == 1.0 else ranges * np.float32(units.ranges)


def scan(
    message: Any,
    T_robot_laser: Pose,
    upside_down: bool = False,
    max_range: float | None = None,
    units: Units = SI,
) -> Scan:
    """The scan of a LaserScan message; ranges outside [range_min, range_max] are no returns.

    `max_range` replaces `range_max`, which a message has in float32 only, and may have too large or not at all. The
    beams of a clockwise scan are reversed. A last beam that repeats the first of a full circle is removed. A negative
    `time_increment`, or one that gives a sweep longer than a second, counts as zero, since many drivers leave it unset.
    """
    first, step = float(message.angle_min) * units.angles, float(message.angle_increment) * units.angles
    ranges = ranges_of(message, units)
    low = np.float32(message.range_min) * np.float32(units.ranges)
    high = stated_reach(message, units)
    count = len(ranges)
    if not 2 <= count <= MOST_BEAMS:
        raise ValueError(f"found a scan of {count} ranges, allowed: 2 to {MOST_BEAMS}")
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0):
        raise ValueError(f"found angle_min {first} and angle_increment {step}, allowed: finite, and steps not zero")
    if abs(step) * (count - 1) > 3.0 * math.pi and (share := angles_disagree(message)) > 1.0:
        found = f"found an angle_increment that spans {share:.3g} times what angle_min and angle_max do"
        raise ValueError(f"{found}, allowed: at most a full turn")
    check_bearings(first, first + step * (count - 1))
    if high is None and max_range is None:
        raise ValueError(f"found range_max {float(message.range_max)}, allowed: metres, 0 to {FARTHEST_M:g}")
    if abs(step) * (count - 1) > 2.0 * math.pi - 0.5 * abs(step):
        count = max(2, round(2.0 * math.pi / abs(step)))
        ranges = ranges[:count]
        count = len(ranges)
    reach = min(float(high or math.inf), math.inf if max_range is None else max_range)
    with np.errstate(invalid="ignore"):
        returned = (ranges <= np.float32(reach)) & ((ranges >= low) if np.isfinite(low) else (ranges > 0.0))
        ranges = np.where(returned, ranges, np.float32(np.inf))
    lag = float(message.time_increment)
    if not 0.0 <= lag * (count - 1) <= _LONGEST_SWEEP_S:
        lag = 0.0
    if upside_down:
        first, step = -first, -step
    if step < 0.0:
        first, step, ranges, lag = first + step * (count - 1), -step, ranges[::-1].copy(), -lag
    ranges.flags.writeable = False
    own = reach if max_range is None else max_range
    return Scan(ranges, np.float32(first), np.float32(step), own, T_robot_laser, np.float32(lag))


def sweep_fault(message: Any, period_s: float) -> str:
    """Why the sweep of a LaserScan cannot be as long as it says, beside the time between scans; "" if it can."""
    sweep_s, scan_s = float(message.time_increment) * (len(message.ranges) - 1), float(message.scan_time)
    if sweep_s < 0.0:
        return "which is negative"
    if 0.0 < _LONGER * period_s < sweep_s:
        return f"longer than the {period_s:.3g} s from one scan to the next"
    share = abs(float(message.angle_increment)) * (len(message.ranges) - 1) / (2.0 * math.pi)
    if 0.0 < sweep_s < _SHORTER * share * scan_s and scan_s < 2.0 * period_s:
        return f"a small part of a scan_time of {scan_s:.3g} s"
    return ""


def angles_disagree(message: Any) -> float:
    """The span of the beams by angle_increment over that by angle_min and angle_max, where these contradict; else 0."""
    by_ends = abs(float(message.angle_max) - float(message.angle_min))
    share = abs(float(message.angle_increment)) * (len(message.ranges) - 1) / max(by_ends, 1e-9)
    return share if by_ends > 0.0 and not 1.0 / _CONTRADICTS < share < _CONTRADICTS else 0.0


def spatial_covariance(cov: Array) -> Array:
    """(6, 6) covariance of x y z roll pitch yaw from (3, 3) of x, y, theta; zero elsewhere."""
    cov6 = np.zeros((6, 6))
    cov6[_PLANE] = cov
    return cov6
