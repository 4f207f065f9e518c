"""The messages of a ROS 1 or ROS 2 bag that a log is made of, in the order of the records."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.core.geometry import Pose
from sixthsense.sources.logs.decompress import bounded
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.odometry_remarks import remarks_on
from sixthsense.sources.logs.ros_frames import Frames, frame_name
from sixthsense.sources.logs.ros_messages import LASER_SCAN, ODOMETRY, planar, stamp_ns, transform
from sixthsense.sources.logs.tf_odometry import OPTION, FramePair, TransformTree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

LARGEST_STAMP_NS = 9_000_000_000 * 1_000_000_000
"""Upper bound of a stamp: nanoseconds must fit into 64 bits."""
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


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
    frames: Frames = field(default_factory=Frames)
    other_frames: Counter[str] = field(default_factory=Counter)
    """number of scans of frames other than that of the first scan"""
    remarks: list[str] = field(default_factory=list)
    has_odometry: bool = True
    """whether the bag has odometry that is used; without it, the robot is said to stand at the first scan"""


def read_recording(path: Path, options: BagOptions) -> Recording:
    """Read the messages; LogError for a topic that is missing or ambiguous, and for one that cannot be used."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    recording = Recording()
    tree = TransformTree(recording.frames)
    with bounded(path), AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        chosen = _choose(path, reader, options)
        uses_tree = options.odometry and ODOMETRY not in chosen
        known = [c for c in reader.connections if c.topic in chosen.values() or _has_transforms(c, uses_tree)]
        for connection, record_ns, raw in reader.messages(connections=known):
            message: Any
            if connection.msgtype in TRANSFORM_TYPES:
                message = reader.deserialize(raw, connection.msgtype)
                is_static = connection.topic.endswith("tf_static")
                for link in message.transforms:
                    parent, child = frame_name(link.header.frame_id), frame_name(link.child_frame_id)
                    if is_static:
                        recording.frames.transforms[child] = (parent, transform(link.transform))
                    else:
                        own = _checked_stamp(path, stamp_ns(link) or record_ns)
                        recording.order.append((False, tree.add(parent, child, own, transform(link.transform))))
            elif connection.topic == chosen.get(connection.msgtype):
                message = reader.deserialize(raw, connection.msgtype)
                _add_message(path, recording, message, record_ns, connection.msgtype == LASER_SCAN)
    if uses_tree and (tree.stamped or options.frames is not None):
        _take_odometry(path, recording, tree, options.frames)
    elif ODOMETRY not in chosen and recording.scans:
        recording.has_odometry = False
        recording.frames.robot = recording.frames.root(recording.frames.laser)
        _stand(recording)
    if recording.has_odometry:
        recording.remarks += remarks_on(recording.odometry)
    return recording


def _has_transforms(connection: Any, with_moving: bool) -> bool:
    name = connection.topic
    return connection.msgtype in TRANSFORM_TYPES and (name.endswith("tf_static") or with_moving)


def _take_odometry(path: Path, recording: Recording, tree: TransformTree, named: FramePair | None) -> None:
    """Take the odometry from the transforms."""
    try:
        pair, poses = tree.odometry(named)
    except ValueError as error:
        raise LogError(f"{path} /tf: {error}") from None
    recording.frames.robot = pair.child
    order, recording.order = recording.order, []
    for is_scan, row in order:
        if is_scan:
            recording.order.append((True, row))
        elif row in poses:
            recording.order.append((False, len(recording.odometry)))
            recording.odometry.append((tree.stamped[row][0], poses[row]))
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
    own = _checked_stamp(path, stamp_ns(message) or record_ns)  # some drivers leave the stamp at zero
    number = len(recording.scans if is_scan else recording.odometry)
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


def _checked_stamp(path: Path, own: int) -> int:
    if not 0 <= own <= LARGEST_STAMP_NS:
        raise LogError(f"{path}: found stamp {own} ns, allowed: 0 to {LARGEST_STAMP_NS} ns")
    return own


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
