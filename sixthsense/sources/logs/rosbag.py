"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick
from sixthsense.sources.logs.decompress import bounded, check_regular
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.laser_geometry import max_range_of
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.ros_frames import Frames, frame_name
from sixthsense.sources.logs.ros_messages import FARTHEST_M, LASER_SCAN, ODOMETRY, planar, scan, stamp_ns, transform

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

LARGEST_STAMP_NS = 9_000_000_000 * 1_000_000_000
"""Upper bound of a stamp: nanoseconds must fit into 64 bits."""


class BagLog(Log):
    """A `Source` that replays a bag."""

    plans: tuple[Array, ...] = ()
    """Planned paths, (N, 2) each; only in the bag of a run."""
    plan_stamps_ns: tuple[int, ...] = ()
    """Record time of each plan."""
    estimates: tuple[tuple[int, Pose, Array], ...] = ()
    """Record time, pose and its covariance (3, 3) at each keyframe; only in the bag of a run."""
    cut_short: bool = False
    """Whether the bag is incomplete because its writer was stopped."""


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    odometry: list[tuple[int, Pose]] = field(default_factory=list)
    """stamp of the header, ns; T_odom_robot"""
    scans: list[tuple[int, Any]] = field(default_factory=list)
    """stamp of the header, ns; message"""
    order: list[tuple[bool, int]] = field(default_factory=list)
    """whether the record is a scan, and its index"""
    frames: Frames = field(default_factory=Frames)
    other_frames: Counter[str] = field(default_factory=Counter)
    """number of scans of frames other than that of the first scan"""
    remarks: list[str] = field(default_factory=list)


def read_bag(file: str | Path, laser: LaserConfig, topics: Sequence[str] = (), is_mount_given: bool = False) -> BagLog:
    """Read a bag: ROS 1 (.bag), or ROS 2 (a folder with metadata.yaml, an .mcap or a .db3 file).

    Scans and odometry are the topics of type LaserScan and Odometry; `topics` selects among several. Beams and ranges
    come from the messages. The mount is `laser.mount` if it is not zero or `is_mount_given`, else that of /tf_static.
    Scans of another frame than the first are left out. Messages are sorted by the stamps of their
    headers if the stamps of each topic ascend, else they keep the order of the file. The stamp of a tick is at least
    1 ns after the previous one. The odometry of a scan is interpolated at its stamp. The stamp of
    a sweep is that of its first beam in the message and of its last beam in the tick.
    Raises LogError for a bag that cannot be read, is damaged or truncated, or lacks a topic of either type.
    """
    path = Path(file)
    # All of it: a bag may define a type with a known name but without the expected fields.
    with as_log_error(path):
        check_regular(path)
        check_first_line(path)
        return _read_log(path, laser, topics, is_mount_given)


def _read_log(path: Path, laser: LaserConfig, topics: Sequence[str], is_mount_given: bool) -> BagLog:
    recording = _read(path, topics)
    if not recording.scans or not recording.odometry:
        missing = "LaserScan" if not recording.scans else "Odometry"
        raise LogError(f"{path}: found a topic of {missing} without a message, allowed: a log with scans and odometry")
    place, upside_down = _mount(path, recording, laser, is_mount_given)
    max_range = _max_range(recording)
    scans = []
    for number, (_, message) in enumerate(recording.scans, start=1):
        try:
            scans.append(scan(message, place, upside_down, max_range))
        except ValueError as error:
            raise LogError(f"{path} scan {number}: {error}") from None
    if not any((s.ranges <= np.float32(s.max_range)).any() for s in scans):
        raise LogError(f"{path}: found no return in {len(scans)} scans, allowed: ranges from range_min to range_max")
    for frame, count in recording.other_frames.items():
        recording.remarks.append(
            f"{count} scans of {shown_name(frame)} are left out, since those of {shown_name(recording.frames.laser)} "
            "are of another laser"
        )
    ticks = _ticks(path, recording, scans)
    return BagLog(ticks, described_laser(scans[0], laser), recording.remarks)


@contextmanager
def as_log_error(path: Path) -> Iterator[None]:
    """A context in which any exception of a reader on a damaged file becomes a LogError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if len(reason) > 160:
            reason = reason[:160] + "..."
        raise LogError(
            f"{path}: cannot be read as a bag ({reason}), allowed: ROS 1 .bag, ROS 2 folder or file"
        ) from None


def check_first_line(path: Path) -> None:
    """Raise ValueError for a ROS 1 bag with an endless first line, which the reader would read as a whole."""
    if path.suffix.lower() == ".bag" and path.is_file():
        with path.open("rb") as stream:
            if not stream.readline(32).endswith(b"\n"):
                raise ValueError("File magic is invalid.")


def _read(path: Path, topics: Sequence[str]) -> _Recording:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    recording = _Recording()
    with bounded(path), AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        chosen = _choose(path, reader, topics)
        known = [c for c in reader.connections if c.topic in chosen.values() or c.topic.endswith("tf_static")]
        for connection, record_ns, raw in reader.messages(connections=known):
            if connection.msgtype in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
                message: Any = reader.deserialize(raw, connection.msgtype)
                for link in message.transforms:
                    parent, child = frame_name(link.header.frame_id), frame_name(link.child_frame_id)
                    recording.frames.transforms[child] = (parent, transform(link.transform))
            elif connection.topic == chosen.get(connection.msgtype):
                message = reader.deserialize(raw, connection.msgtype)
                _add_message(path, recording, message, record_ns, connection.msgtype == LASER_SCAN)
    return recording


def _choose(path: Path, reader: AnyReader, topics: Sequence[str]) -> dict[str, str]:
    """The topic of each type; LogError with the candidates unless there is one, or one is selected."""
    types = {c.topic: c.msgtype for c in reader.connections}
    fitting = {kind: sorted(t for t, name in types.items() if name == kind) for kind in (LASER_SCAN, ODOMETRY)}
    for topic in topics:
        if types.get(topic) not in fitting:
            found = (
                f"{topic!r}, of type {shown_name(types[topic])}" if topic in types else f"{topic!r}, no topic of {path}"
            )
            offered = sorted(itertools.chain(*fitting.values()))
            allowed = (
                allowed_names(map(shown_name, offered), nearest(topic, offered)) if offered else "allowed: none here"
            )
            raise LogError(f"--topic: found {found}, {allowed}")
    chosen = {}
    for kind, names in fitting.items():
        short = kind.rpartition("/")[2]
        if not names:
            held = (
                ", ".join(f"{shown_name(t)} ({shown_name(n.rpartition('/')[2])})" for t, n in sorted(types.items())[:8])
                or "no topic at all"
            )
            raise LogError(f"{path}: found no topic of type {short}, but {held}, allowed: a bag with one")
        left = [name for name in names if name in topics] or names
        if len(left) > 1:
            either = " or ".join(map(shown_name, left))
            raise LogError(f"{path}: found {len(left)} topics of type {short}, allowed: one, by --topic {either}")
        chosen[kind] = left[0]
    return chosen


def _add_message(path: Path, recording: _Recording, message: Any, record_ns: int, is_scan: bool) -> None:
    own = stamp_ns(message) or record_ns  # some drivers leave the stamp at zero
    number = len(recording.scans if is_scan else recording.odometry)
    if not 0 <= own <= LARGEST_STAMP_NS:
        raise LogError(f"{path}: found stamp {own} ns, allowed: 0 to {LARGEST_STAMP_NS} ns")
    if is_scan:
        frame = frame_name(message.header.frame_id)
        recording.frames.laser = recording.frames.laser or frame
        if frame != recording.frames.laser:
            recording.other_frames[frame] += 1
            return
        recording.scans.append((own, message))
    else:
        recording.frames.robot = recording.frames.robot or frame_name(message.child_frame_id)
        try:
            pose = planar(message.pose.pose.position, message.pose.pose.orientation)
        except ValueError as error:
            raise LogError(f"{path} odometry {number + 1}: {error}") from None
        recording.odometry.append((own, pose))
    recording.order.append((is_scan, number))


def _mount(path: Path, recording: _Recording, laser: LaserConfig, is_given: bool) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    frames = recording.frames
    try:
        found = frames.mount()
    except ValueError as error:
        raise LogError(f"{path} /tf_static: {error}") from None
    place, upside_down = found or (Pose(), False)
    if is_given or any(laser.mount):
        return Pose(*laser.mount), upside_down
    if found is None:
        recording.remarks.append(
            f"assumed: the laser at the robot's centre, since no /tf_static leads from {shown_name(frames.robot)} to "
            f"{shown_name(frames.laser)} (otherwise set laser.mount)"
        )
    return place, upside_down


def _max_range(recording: _Recording) -> float | None:
    """Metres, by the ranges themselves where the first message has no plausible `range_max`; None where it has one."""
    if not float(recording.scans[0][1].range_max) > FARTHEST_M:
        return None
    ranges = [np.asarray(message.ranges, dtype=np.float32) for _, message in recording.scans]
    found = max_range_of(ranges)
    recording.remarks.append(f"assumed: a laser of {found:.2f} m, since range_max is not the range of a laser")
    return found


def described_laser(first: Scan, laser: LaserConfig) -> LaserConfig:
    """The configuration of the laser that took a scan."""
    step, count = float(first.angle_increment), len(first.ranges)
    fov = 2.0 * math.pi if first.closed else min(step * (count - 1), 2.0 * math.pi)
    place = first.T_robot_laser
    return replace(laser, beams=count, fov=fov, max_range=first.max_range, mount=(place.x, place.y, place.theta))


def _ticks(path: Path, recording: _Recording, scans: Sequence[Scan]) -> list[Tick]:
    """One tick per message, and one for odometry and scan with the same stamp, from the first odometry on."""
    odometry = recording.odometry

    ends = [own - sweep_ns(len(s.ranges), s.time_increment) for (own, _), s in zip(recording.scans, scans, strict=True)]

    def stamp(entry: tuple[bool, int]) -> int:
        return ends[entry[1]] if entry[0] else odometry[entry[1]][0]

    order = recording.order
    if _ascends(recording.scans) and _ascends(odometry):
        if recording.scans[0][0] > odometry[-1][0] or recording.scans[-1][0] < odometry[0][0]:
            spans = [f"{s[0][0] * 1e-9:.3f} to {s[-1][0] * 1e-9:.3f} s" for s in (recording.scans, odometry)]
            raise LogError(f"{path}: found scans from {spans[0]}, odometry from {spans[1]}, allowed: one clock")
        order = sorted(order, key=lambda entry: (stamp(entry), entry[0]))
    ticks: list[Tick] = []
    clock, last = -1, -1
    for entry in order:
        is_scan, number = entry
        own = stamp(entry)
        if not is_scan:
            last = number
        if last < 0:
            continue  # the pose of the robot is not known yet
        if is_scan:
            log_stamp_s = recording.scans[number][0] / 1e9
            if ticks and ticks[-1].scan is None and own == odometry[last][0]:
                ticks[-1] = replace(ticks[-1], scan=scans[number], log_stamp_s=log_stamp_s)
                continue
            clock = max(own, clock + 1)
            pose = _interpolate(odometry, last, own)
            ticks.append(Tick(clock, pose, scans[number], log_stamp_s=log_stamp_s))
        else:
            clock = max(own, clock + 1)
            ticks.append(Tick(clock, odometry[number][1]))
    if not any(tick.scan is not None for tick in ticks):
        raise LogError(f"{path}: found no scan after the first odometry, allowed: a log with both")
    return ticks


def _ascends(stamped: Sequence[tuple[int, Any]]) -> bool:
    return all(a[0] <= b[0] for a, b in itertools.pairwise(stamped))


def _interpolate(odometry: Sequence[tuple[int, Pose]], last: int, at_ns: int) -> Pose:
    """Odometry interpolated at a stamp between message `last` and the next; that of `last` for any other stamp."""
    before_ns, before = odometry[last]
    after_ns, after = odometry[min(last + 1, len(odometry) - 1)]
    if not before_ns < at_ns < after_ns:
        return before
    motion, share = before.inverse() @ after, (at_ns - before_ns) / (after_ns - before_ns)
    return before @ Pose(share * motion.x, share * motion.y, share * motion.theta)
