"""The messages of a ROS 1 or ROS 2 bag that a log is made of, in the order of the records."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sixthsense.config.section import shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.core.geometry import Pose
from sixthsense.sources.logs.bag_file import checked_stamp
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.oddities import remarks_on
from sixthsense.sources.logs.ros_messages import LASER_SCAN, ODOMETRY, frame_name, planar, stamp_ns
from sixthsense.sources.logs.transforms import OPTION, TRANSFORM_TYPES, FramePair, TransformTree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


class BagOptions(NamedTuple):
    """What is read of a bag."""

    topics: Sequence[str] = ()
    """chosen among several of one type"""
    frames: FramePair | None = None
    """of odometry in /tf; None: a topic of Odometry, else the frames that are found"""
    odometry: bool = True
    """whether odometry is read"""


@dataclass(slots=True)
class Recording:
    """The messages of a bag in the order of its records."""

    odometry: list[tuple[int, Pose]] = field(default_factory=list)
    """stamp of the header, ns; T_odom_robot"""
    scans: list[tuple[int, Any]] = field(default_factory=list)
    """stamp of the header, ns; message"""
    order: list[tuple[bool, int]] = field(default_factory=list)
    """whether the record is a scan, and its index"""
    tree: TransformTree = field(default_factory=TransformTree)
    robot: str = ""
    """frame of the odometry"""
    laser: str = ""
    """frame of the first scan"""
    other_frames: Counter[str] = field(default_factory=Counter)
    """number of scans of frames other than that of the first scan"""
    remarks: list[str] = field(default_factory=list)
    has_odometry: bool = True
    """whether the bag has odometry that is used; without it, the robot is said to stand at the first scan"""


def read_recording(path: Path, reader: AnyReader, options: BagOptions) -> Recording:
    """Read the messages; LogError for a topic that is missing or ambiguous, and for one that cannot be used."""
    recording = Recording()
    chosen = _choose(path, reader, options)
    uses_tree = options.odometry and ODOMETRY not in chosen
    known = [c for c in reader.connections if c.topic in chosen.values() or _has_transforms(c, uses_tree)]
    for connection, record_ns, raw in reader.messages(connections=known):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype in TRANSFORM_TYPES:
            rows = recording.tree.take(str(path), connection.topic, message, record_ns)
            recording.order += [(False, row) for row in rows]
        elif connection.topic == chosen.get(connection.msgtype):
            _add_message(path, recording, message, record_ns, connection.msgtype == LASER_SCAN)
    if uses_tree and (recording.tree.stamped or options.frames is not None):
        _take_odometry(path, recording, options.frames)
    elif ODOMETRY not in chosen and recording.scans:
        recording.has_odometry = False
        recording.robot = recording.tree.root(recording.laser)
        _stand(recording)
    if recording.has_odometry:
        recording.remarks += remarks_on(recording.odometry)
    return recording


def _has_transforms(connection: Any, with_moving: bool) -> bool:
    name = connection.topic
    return connection.msgtype in TRANSFORM_TYPES and (name.endswith("tf_static") or with_moving)


def _take_odometry(path: Path, recording: Recording, named: FramePair | None) -> None:
    """Take the odometry from the transforms."""
    try:
        pair, poses = recording.tree.odometry(recording.laser, named)
    except ValueError as error:
        raise LogError(f"{path} /tf: {error}") from None
    recording.robot = pair.child
    order, recording.order = recording.order, []
    for is_scan, row in order:
        if is_scan:
            recording.order.append((True, row))
        elif row in poses:
            recording.order.append((False, len(recording.odometry)))
            recording.odometry.append((recording.tree.stamped[row][0], poses[row]))
    recording.remarks.append(f"odometry: /tf {pair}, {len(recording.odometry)} transforms (otherwise {OPTION})")


def _stand(recording: Recording) -> None:
    """Let a robot without odometry stand at each scan."""
    recording.odometry = [(own, Pose()) for own, _ in recording.scans]
    recording.order = [entry for k in range(len(recording.scans)) for entry in ((False, k), (True, k))]


def _choose(path: Path, reader: AnyReader, options: BagOptions) -> dict[str, str]:
    """The topic of each type; LogError with the candidates unless there is one, or one is selected."""
    topics = options.topics
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
        if kind == ODOMETRY and (not names or options.frames is not None or not options.odometry):
            continue
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


def _add_message(path: Path, recording: Recording, message: Any, record_ns: int, is_scan: bool) -> None:
    own = checked_stamp(str(path), stamp_ns(message) or record_ns)  # some drivers leave the stamp at zero
    number = len(recording.scans if is_scan else recording.odometry)
    if is_scan:
        frame = frame_name(message.header.frame_id)
        recording.laser = recording.laser or frame
        if frame != recording.laser:
            recording.other_frames[frame] += 1
            return
        recording.scans.append((own, message))
    else:
        recording.robot = recording.robot or frame_name(message.child_frame_id)
        try:
            pose = planar(message.pose.pose.position, message.pose.pose.orientation)
        except ValueError as error:
            raise LogError(f"{path} odometry {number + 1}: {error}") from None
        recording.odometry.append((own, pose))
    recording.order.append((is_scan, number))
