"""ROS messages as stamps, planar poses, covariances and scans; ValueError for what is not allowed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.logs.laser_geometry import FARTHEST_M, MOST_BEAMS
from sixthsense.logs.text_lines import LARGEST, LAST_STAMP_S

ODOMETRY = "nav_msgs/msg/Odometry"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"

_PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw of x y z roll pitch yaw

_LONGEST_SWEEP_S = 1.0
_LEAST_UPRIGHT = 0.9  # cosine of the largest tilt of a planar scan
_LONGER, _SHORTER, _CONTRADICTS = 1.1, 0.25, 1.2  # of a sweep beside its turn; and of spans of angles


def stamp_ns(message: Any) -> int:
    """The stamp of the header, nanoseconds; ValueError for one that does not fit into 64 bits."""
    stamp = message.header.stamp
    if not 0 <= stamp.sec <= LAST_STAMP_S:
        raise ValueError(f"found a stamp of {stamp.sec} s, allowed: 0 to {LAST_STAMP_S} s")
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def frame_name(name: str) -> str:
    """The name of a frame without the leading slash of ROS 1."""
    return str(name).lstrip("/")


def pose_numbers(message: Any) -> list[float]:
    """The numbers x y z qx qy qz qw of a Pose or a Transform; ValueError unless they are finite, and a rotation."""
    place = message.position if hasattr(message, "position") else message.translation
    turn = message.orientation if hasattr(message, "orientation") else message.rotation
    found = [float(value) for value in (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)]
    if not (max(map(abs, found)) <= LARGEST and any(found[3:]) and all(map(math.isfinite, found))):
        raise ValueError(f"found a pose of {tuple(found)}, allowed: up to {LARGEST:.0e} and a quaternion that is not 0")
    return found


def planar(message: Any) -> Pose:
    """A Pose or a Transform projected onto the plane; exact for a rotation about z."""
    x, y, _, *turn = pose_numbers(message)
    norm = math.hypot(*turn)
    a, b, c, w = (value / norm for value in turn)
    if a == b == 0.0:
        return Pose(x, y, 2.0 * math.atan2(turn[2], turn[3]))
    return Pose(x, y, math.atan2(2.0 * (w * c + a * b), w * w + a * a - b * b - c * c))


def transform(message: Any) -> Array:
    """(4, 4) matrix of a Pose or a Transform."""
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    found = np.array(pose_numbers(message))
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(found[3:] / math.hypot(*found[3:])).as_matrix()
    out[:3, 3] = found[:3]
    return out


def planar_of(T: Array) -> Pose:
    """A (4, 4) matrix projected onto the plane; exact for a rotation about z."""
    return Pose(T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0]))


def mount(T_robot_laser: Array) -> tuple[Pose, bool]:
    """The planar mount of the laser from a (4, 4) matrix, and whether the laser is upside down."""
    if abs(T_robot_laser[2, 2]) < _LEAST_UPRIGHT:
        raise ValueError("found a laser tilted out of the plane, allowed: a level one")
    return planar_of(T_robot_laser), bool(T_robot_laser[2, 2] < 0.0)


def stated_reach(message: Any) -> float | None:
    """The `range_max` of a LaserScan, m; None where it is not that of a laser: zero, infinite, or no number."""
    reach = float(np.float32(message.range_max))
    return reach if 0.0 < reach <= FARTHEST_M else None


def ranges_of(message: Any) -> NDArray[np.float32]:
    """(N,) ranges, m, of a LaserScan, or the first echoes of a MultiEchoLaserScan; infinite without an echo."""
    rows: Any = message.ranges
    if len(rows) and hasattr(rows[0], "echoes"):
        rows = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in rows]
    return np.asarray(rows, dtype=np.float32)


def scan(
    message: Any,
    T_robot_laser: Pose,
    upside_down: bool = False,
    max_range: float | None = None,
) -> Scan:
    """The scan of a LaserScan message; ranges outside [range_min, range_max] are no returns.

    `max_range` replaces `range_max`, which a message has in float32 only, and may have too large or not at all. The
    beams of a clockwise scan are reversed. A last beam that repeats the first of a full circle is removed. A negative
    `time_increment`, or one that gives a sweep longer than a second, counts as zero, since many drivers leave it unset.
    """
    ranges, high = ranges_of(message), stated_reach(message)
    if not 2 <= len(ranges) <= MOST_BEAMS:
        raise ValueError(f"found a scan of {len(ranges)} ranges, allowed: 2 to {MOST_BEAMS}")
    first, step = _beams(message, len(ranges))
    if high is None and max_range is None:
        raise ValueError(f"found range_max {float(message.range_max)}, allowed: metres, 0 to {FARTHEST_M:g}")
    if abs(step) * (len(ranges) - 1) > 2.0 * math.pi - 0.5 * abs(step):
        ranges = ranges[: max(2, round(2.0 * math.pi / abs(step)))]
    count = len(ranges)
    reach = min(high or math.inf, math.inf if max_range is None else max_range)
    low = np.float32(message.range_min)
    with np.errstate(invalid="ignore"):
        returned = (ranges <= np.float32(reach)) & ((ranges >= low) if np.isfinite(low) else (ranges > 0.0))
        ranges = np.where(returned, ranges, np.float32(np.inf))
    lag = float(message.time_increment)
    lag = lag if 0.0 <= lag * (count - 1) <= _LONGEST_SWEEP_S else 0.0
    if upside_down:
        first, step = -first, -step
    if step < 0.0:
        first, step, ranges, lag = first + step * (count - 1), -step, ranges[::-1].copy(), -lag
    ranges.flags.writeable = False
    own = reach if max_range is None else max_range
    return Scan(ranges, np.float32(first), np.float32(step), own, T_robot_laser, np.float32(lag))


def _beams(message: Any, count: int) -> tuple[float, float]:
    """Bearing of the first beam and angle between two, rad; ValueError for angles that no laser has."""
    first, step = float(message.angle_min), float(message.angle_increment)
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0):
        raise ValueError(f"found angle_min {first} and angle_increment {step}, allowed: finite, and steps not zero")
    last = first + step * (count - 1)
    if abs(last - first) > 3.0 * math.pi:  # some drivers send a few beams more than a full turn
        if (share := angles_disagree(message)) > 1.0:
            found = f"found an angle_increment that spans {share:.3g} times what angle_min and angle_max do"
            raise ValueError(f"{found}, allowed: at most a full turn")
        found = f"found angles of {first:.6g} to {last:.6g}, which are degrees"
        raise ValueError(f"{found}, allowed: radians")
    return first, step


def sweep_fault(message: Any, period_s: float) -> str:
    """Why the sweep of a LaserScan cannot be as long as it says, beside the time of a turn; "" if it can.

    That is scan_time, if it is not far longer than the time between scans, else the time between scans.
    """
    sweep_s, scan_s = float(message.time_increment) * (len(message.ranges) - 1), float(message.scan_time)
    share = abs(float(message.angle_increment)) * (len(message.ranges) - 1) / (2.0 * math.pi)
    states_turn = 0.0 < scan_s < 2.0 * period_s
    turn_s = max(scan_s, period_s) if states_turn else period_s
    if sweep_s < 0.0 or 0.0 < _LONGER * turn_s < sweep_s or 0.0 < sweep_s < states_turn * _SHORTER * share * scan_s:
        return f"beside {turn_s:.3g} s from one scan to the next"
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
