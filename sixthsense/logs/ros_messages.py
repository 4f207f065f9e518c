"""ROS messages as stamps, planar poses, scans and a tree of frames; ValueError for what is not allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.logs.laser_geometry import FARTHEST_M, MOST_BEAMS
from sixthsense.logs.text_lines import LARGEST

_STILL = 1e-6  # m, and numbers of a quaternion, by which a transform of /tf differs that does not move
_LEAST_UPRIGHT = 0.9  # cosine of the largest tilt of a planar scan


class FramePair(NamedTuple):
    """Two frames, such as odom and base_link."""

    parent: str
    child: str

    def __str__(self) -> str:
        return f"{shown_name(self.parent)} -> {shown_name(self.child)}"


@dataclass(slots=True)
class Link:
    """The transforms between two frames."""

    first: list[float]
    """x y z qx qy qz qw of the first one"""
    moves: bool = False
    """whether it ever changes"""
    stamped: list[tuple[int, int, Pose]] = field(default_factory=list)
    """of those of /tf: stamp of the header and time of recording, ns, and `T_parent_child` in the plane"""

    def matrix(self) -> Array:
        """(4, 4) T_parent_child of the first one."""
        from scipy.spatial.transform import Rotation  # here, since it takes a while to load

        out = np.eye(4)
        out[:3, :3], out[:3, 3] = Rotation.from_quat(self.first[3:]).as_matrix(), self.first[:3]
        return out


class TransformTree:
    """The transforms between frames: static ones, and those of /tf with their stamps."""

    def __init__(self) -> None:
        self.links: dict[FramePair, Link] = {}
        """by parent and child"""

    def take(self, topic: str, message: Any, record_ns: int) -> None:
        """Add the transforms of a message, up to one that cannot be used, of which ValueError is raised."""
        for one in message.transforms:
            pair = FramePair(frame_name(one.header.frame_id), frame_name(one.child_frame_id))
            numbers = pose_numbers(one.transform)
            if topic.endswith("tf_static"):
                self.links[pair] = Link(numbers)
                continue
            link = self.links.setdefault(pair, Link(numbers))
            link.moves |= max(abs(a - b) for a, b in zip(link.first, numbers, strict=True)) > _STILL
            link.stamped.append((stamp_ns(one) or record_ns, record_ns, planar(one.transform)))

    def add_static(self, parent: str, child: str, transform: Any) -> None:
        """Add the message of a static transform, in place of an earlier one; ValueError for one that is none."""
        self.links[FramePair(parent, child)] = Link(pose_numbers(transform))

    def frames(self) -> list[str]:
        """The names of all frames."""
        return sorted({frame for pair in self.links for frame in pair})

    def root(self, frame: str) -> str:
        """The last frame on the way from a frame to its root that is fixed to it."""
        return [*self.fixed(frame)][-1]

    def fixed(self, frame: str) -> dict[str, Array]:
        """(4, 4) T_other_frame of a frame and all above it that it is fixed to, by name; the last is the root."""
        found = {frame: np.eye(4)}
        while True:
            child, T_child_frame = list(found.items())[-1]
            up = [each for each, link in self.links.items() if each.child == child and not link.moves]
            up = [each for each in up if each.parent not in found]
            if not up:
                return found
            found[up[0].parent] = self.links[up[0]].matrix() @ T_child_frame

    def mount(self, robot: str, laser: str) -> tuple[Pose, bool] | None:
        """`T_robot_laser`, and whether the laser is upside down; None if no constant transforms connect them.

        They may lead either way: some robots send the laser as the parent. Raises ValueError for a laser that is not
        level.
        """
        of_robot, of_laser = self.fixed(robot), self.fixed(laser)
        shared = next((frame for frame in of_robot if frame in of_laser), None)
        if shared is None:
            return None
        T = np.linalg.inv(of_robot[shared]) @ of_laser[shared]
        if abs(T[2, 2]) < _LEAST_UPRIGHT:
            raise ValueError("found a laser tilted out of the plane, allowed: a level one")
        return Pose(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0]))), bool(T[2, 2] < 0.0)

    def odometry(self, laser: str, named: FramePair | None) -> FramePair | None:
        """The frames of odometry: those named, or those of the only transform that moves what the laser is fixed to.

        Without one of these, of the only one that moves at all; None if none does. Raises ValueError for a pair that
        is not in /tf, and where several may be odometry.
        """
        moving, fixed = [pair for pair, link in self.links.items() if link.moves], self.fixed(laser)
        found = [named] if named else [pair for pair in moving if pair.child in fixed] or moving
        if len(found) > 1 or (named and not (named in self.links and self.links[named].stamped)):
            there = ", ".join(map(str, sorted(moving)[:8])) or "no transform that moves"
            allowed = f"allowed: one of these in /tf, by `odometry_frames` PARENT,CHILD: {there}"
            raise ValueError(f"found {' and '.join(map(str, found))}, {allowed}")
        return found[0] if found else None


ODOMETRY = "nav_msgs/msg/Odometry"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"

_PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw of x y z roll pitch yaw

_LONGEST_SWEEP_S = 1.0
_LONGER, _SHORTER = 1.1, 0.25  # of a sweep beside its turn
_CONTRADICTS = 1.2  # of spans of angles


def stamp_ns(message: Any) -> int:
    """The stamp of the header, nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def frame_name(name: str) -> str:
    """The name of a frame without the leading slash of ROS 1."""
    return str(name).lstrip("/")


def pose_numbers(message: Any) -> list[float]:
    """The numbers x y z qx qy qz qw of a message with a Pose or a Transform, or of these.

    Raises ValueError unless they are finite, and a rotation.
    """
    while (inner := getattr(message, "pose", None) or getattr(message, "transform", None)) is not None:
        message = inner
    place = message.position if hasattr(message, "position") else message.translation
    turn = message.orientation if hasattr(message, "orientation") else message.rotation
    found = [float(value) for value in (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)]
    if not (max(map(abs, found)) <= LARGEST and any(found[3:]) and all(map(math.isfinite, found))):
        raise ValueError(f"found a pose of {tuple(found)}, allowed: up to {LARGEST:.0e} and a quaternion that is not 0")
    return found


def planar(message: Any) -> Pose:
    """The pose of a message projected onto the plane."""
    x, y, _, *turn = pose_numbers(message)
    a, b, c, w = (value / math.hypot(*turn) for value in turn)
    return Pose(x, y, math.atan2(2.0 * (w * c + a * b), w * w + a * a - b * b - c * c))


def stated_reach(message: Any) -> float | None:
    """The `range_max` of a LaserScan, m; None where it is not that of a laser: zero, infinite, or no number."""
    reach = float(np.float32(message.range_max))
    return reach if 0.0 < reach <= FARTHEST_M else None


def scan(message: Any, T_robot_laser: Pose, max_range: float | None = None) -> Scan:
    """The scan of a LaserScan message; ranges below range_min, and at range_max or beyond, are no returns.

    Of a MultiEchoLaserScan it has the first echoes.
    `max_range` replaces `range_max`, which a message has in float32 only, and may have too large or not at all. The
    beams of a clockwise scan are reversed. A last beam that repeats the first of a full circle is removed. A negative
    `time_increment`, or one that gives a sweep longer than a second, counts as zero, since many drivers leave it unset.
    """
    (first, step), rows = _beams(message), message.ranges
    if hasattr(rows[0], "echoes"):
        rows = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in rows]
    ranges: NDArray[np.float32] = np.asarray(rows, dtype=np.float32)
    stated = stated_reach(message) or max_range
    if stated is None:
        raise ValueError(f"found range_max {float(message.range_max)}, allowed: metres, 0 to {FARTHEST_M:g}")
    if abs(step) * (len(ranges) - 1) > 2.0 * math.pi - 0.5 * abs(step):
        ranges = ranges[: max(2, round(2.0 * math.pi / abs(step)))]
    low, count = np.float32(message.range_min), len(ranges)
    with np.errstate(invalid="ignore"):
        is_far = ranges >= np.float32(min(stated, max_range or stated))
        is_near = ranges < low if np.isfinite(low) else ranges <= 0.0
        ranges = np.where(is_far | is_near | np.isnan(ranges), np.float32(np.inf), ranges)
    lag = float(message.time_increment)
    lag = lag if 0.0 <= lag * (count - 1) <= _LONGEST_SWEEP_S else 0.0
    if step < 0.0:
        first, step, ranges, lag = first + step * (count - 1), -step, ranges[::-1].copy(), -lag
    ranges.flags.writeable = False
    return Scan(ranges, np.float32(first), np.float32(step), max_range or stated, T_robot_laser, np.float32(lag))


def _beams(message: Any) -> tuple[float, float]:
    """Bearing of the first beam and angle between two, rad; ValueError for what no laser has."""
    count, first, step = len(message.ranges), float(message.angle_min), float(message.angle_increment)
    span, share = abs(step) * (count - 1), angles_disagree(message)
    if not 2 <= count <= MOST_BEAMS:
        raise ValueError(f"found a scan of {count} ranges, allowed: 2 to {MOST_BEAMS}")
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0):
        raise ValueError(f"found angle_min {first} and angle_increment {step}, allowed: finite, and steps not zero")
    if span > 3.0 * math.pi:  # some drivers send a few beams more than a full turn
        of_twice = f"an angle_increment that spans {share:.3g} times what angle_min and angle_max do"
        found = of_twice if share > 1.0 else f"angles of {first:.6g} to {first + span:.6g}, which are degrees"
        raise ValueError(f"found {found}, allowed: radians, at most a full turn")
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
