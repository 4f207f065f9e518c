"""ROS messages as values of ours: stamps, planar poses, scans; each raises ValueError for numbers that will not do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan

ODOMETRY = "nav_msgs/msg/Odometry"
LASER_SCAN = "sensor_msgs/msg/LaserScan"

_FARTHEST_M = 1000.0
_FAR_OFF_M = 1e10  # of a frame's origin; squares and products of what is farther are no numbers in the end
_MOST_BEAMS = 100_000
_LONGEST_SWEEP_S = 1.0
_LEAST_UPRIGHT = 0.9  # cosine of the tilt at which a scan is no longer one of the plane


def stamp_ns(message: Any) -> int:
    """The header's stamp, whole nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def planar(position: Any, orientation: Any) -> Pose:
    """Position and quaternion, seen from above; exact where the turn is about z alone."""
    x, y, z, w = (float(v) for v in (orientation.x, orientation.y, orientation.z, orientation.w))
    values = (float(position.x), float(position.y), x, y, z, w)
    norm = math.hypot(x, y, z, w)
    if not (all(map(math.isfinite, (*values, norm))) and norm > 0.0):
        raise ValueError(f"found a pose of {values}, allowed: finite numbers and a quaternion that is not zero")
    if max(abs(values[0]), abs(values[1])) > _FAR_OFF_M:
        raise ValueError(f"found a pose at ({values[0]}, {values[1]}), allowed: up to {_FAR_OFF_M:.0e} m")
    if x == 0.0 and y == 0.0:
        return Pose(values[0], values[1], 2.0 * math.atan2(z, w))
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return Pose(values[0], values[1], math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def transform(message: Any) -> Array:
    """(4, 4) matrix of a geometry_msgs/Transform."""
    r, t = message.rotation, message.translation
    q = np.array([r.x, r.y, r.z, r.w], dtype=np.float64)
    t_xyz = np.array([t.x, t.y, t.z], dtype=np.float64)
    norm = math.hypot(*q)  # which does not overflow on the way
    if not (np.abs(t_xyz).max() <= _FAR_OFF_M and math.isfinite(norm) and norm > 0.0):  # false for NaN
        raise ValueError(
            f"found a transform that is not finite, allowed: up to {_FAR_OFF_M:.0e} m and a quaternion that is not zero"
        )
    x, y, z, w = q / norm
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = t_xyz
    return out


def mount(T_robot_laser: Array) -> tuple[Pose, bool]:
    """The laser's place in the plane, from a (4, 4) matrix, and whether the laser hangs upside down."""
    if abs(T_robot_laser[2, 2]) < _LEAST_UPRIGHT:
        raise ValueError("found a laser that is tilted out of the plane, allowed: one that is level")
    yaw = math.atan2(T_robot_laser[1, 0], T_robot_laser[0, 0])
    return Pose(T_robot_laser[0, 3], T_robot_laser[1, 3], yaw), bool(T_robot_laser[2, 2] < 0.0)


def scan(message: Any, T_robot_laser: Pose, upside_down: bool = False, max_range: float | None = None) -> Scan:
    """A scan as its message says; ranges outside [range_min, range_max] met nothing.

    `max_range` is `range_max` with all its digits, where they are known. A scan that runs clockwise is turned round, a
    beam that repeats the first of a full circle left out. A `time_increment` that makes no sweep of at most a second is
    none: many drivers leave it unset.
    """
    first, step = float(message.angle_min), float(message.angle_increment)
    ranges = np.asarray(message.ranges, dtype=np.float32)
    low, high = np.float32(message.range_min), np.float32(message.range_max)
    count = len(ranges)
    if not 2 <= count <= _MOST_BEAMS:
        raise ValueError(f"found a scan of {count} ranges, allowed: 2 to {_MOST_BEAMS}")
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0):
        raise ValueError(f"found angle_min {first} and angle_increment {step}, allowed: finite, and steps not zero")
    if not high > 0.0:
        raise ValueError(f"found range_max {high}, allowed: metres, above 0")
    if abs(step) * (count - 1) > 2.0 * math.pi - 0.5 * abs(step):
        count = max(2, round(2.0 * math.pi / abs(step)))
        ranges = ranges[:count]
        count = len(ranges)
    with np.errstate(invalid="ignore"):
        ranges = np.where((ranges >= low) & (ranges <= high), ranges, np.float32(np.inf))
    lag = float(message.time_increment)
    if not 0.0 <= lag * (count - 1) <= _LONGEST_SWEEP_S:
        lag = 0.0
    if upside_down:
        first, step = -first, -step
    if step < 0.0:
        first, step, ranges, lag = first + step * (count - 1), -step, ranges[::-1].copy(), -lag
    ranges.flags.writeable = False
    reach = min(float(high), _FARTHEST_M) if max_range is None else max_range
    return Scan(ranges, np.float32(first), np.float32(step), reach, T_robot_laser, np.float32(lag))
