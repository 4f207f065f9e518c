"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import sweep_ns
from sixthsense.logs.bag_file import only_topic, opened
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.logs.laser_geometry import faults_of, max_range_of
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    angles_disagree,
    checked_stamp,
    frame_name,
    planar,
    ranges_of,
    scan,
    stamp_ns,
    stated_reach,
    sweep_fault,
)
from sixthsense.logs.stamps import ascending, passed_s
from sixthsense.logs.transforms import TRANSFORM_TYPES, FramePair, TransformTree
from sixthsense.logs.units import SI, Units

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

T = TypeVar("T")
_SCANS = (LASER_SCAN, MULTI_ECHO)
_POSES = ("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped")
_SINCE_1970_NS = 10**17
"""Stamps of a clock that shows the time are larger: one of 0 among them is not set."""


class How(NamedTuple):
    """How a bag is read."""

    topics: Sequence[str] = ()
    """of scans and odometry, among several"""
    frames: FramePair | None = None
    """of odometry in /tf"""
    odometry: bool = True
    """whether the bag's odometry is used"""
    units: Units = SI
    """of the bag's numbers"""


class _Stamped(NamedTuple):
    """A message with its stamps."""

    own_ns: int
    """of its header"""
    record_ns: int
    message: Any


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    tree: TransformTree
    found: list[Finding] = field(default_factory=list)
    scans: list[_Stamped] = field(default_factory=list)
    odometry: list[_Stamped] = field(default_factory=list)
    """with `T_odom_robot` in place of the message"""
    robots: Counter[str] = field(default_factory=Counter)
    """number of messages of odometry by the robot's frame"""
    lasers: Counter[str] = field(default_factory=Counter)
    """number of scans by frame"""
    refused: dict[str, list[str]] = field(default_factory=dict)
    """what is wrong with messages that are left out, by topic"""

    @property
    def laser(self) -> str:
        """The frame of most scans."""
        return max(self.lasers, key=lambda name: (self.lasers[name], name))

    def refuse(self, topic: str, error: Exception) -> None:
        """Leave out a message of a topic."""
        self.refused.setdefault(topic, []).append(reason_of(error))


def read_bag(file: str | Path, laser: LaserConfig, how: How | None = None) -> Log:
    """Read a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file).

    Scans and odometry are the topics of type LaserScan, or MultiEchoLaserScan, and Odometry; a topic of poses is
    odometry where it is named. Without a topic of odometry, or with `how.frames`, odometry is a pair of frames in /tf;
    without transforms there, the log has scans alone. Beams and ranges are those of each message. Scans are of the
    frame that most of them have. The mount is `laser.mount` if it is stated, else that of /tf_static, or of /tf where
    it stands still.

    Stamps are those of the headers, of the recording where these are not set or do not ascend. The stamp of a sweep is
    that of its first beam in the message and of its last beam in the tick. A message that cannot be used is left out,
    and counted. Raises InputError for a bag that cannot be read, that lacks a topic of scans or a scan that can be
    used, or whose odometry in /tf is not clear.
    """
    path, how = Path(file), how or How()
    with opened(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}
        types = types or {c.topic: c.msgtype for c in reader.connections}
        for topic in how.topics:
            only_topic(
                path, types, (*_SCANS, ODOMETRY, *_POSES), "`topics`", set(types) - {topic}, f"no topic {topic!r}"
            )
        of_scans, of_odometry = _chosen(path, types, how)
        recording = _recording(path, reader, of_scans, of_odometry, how)
    place, upside_down = _mount(path, recording, laser, bool(of_odometry))
    own = _own_frame(recording)
    limit = max_range_of(
        [ranges_of(each.message, how.units) for each in own if stated_reach(each.message, how.units) is None]
    )
    made: list[tuple[_Stamped, Any]] = []
    for each in own:
        reach = limit if stated_reach(each.message, how.units) is None else None
        try:
            made.append((each, scan(each.message, place, upside_down != laser.mirrored, reach, how.units)))
        except ValueError as error:
            recording.refuse(of_scans, error)
    if not made:
        raise InputError(f"{path} {of_scans}", f"found no scan that can be used: {recording.refused[of_scans][0]}")
    ranges = [ranges_of(each.message, how.units) for each, _ in made]
    recording.found += faults_of(ranges, [one for _, one in made])
    _describe(recording, [each.message for each, _ in made], limit)
    for topic, reasons in recording.refused.items():
        text = f"messages of {topic} are left out, the first: {reasons[0]}"
        recording.found.append(Finding("left_out", len(reasons), place=text))
    return _log(recording, made, laser, how.units.odometry)


def _chosen(path: Path, types: dict[str, str], how: How) -> tuple[str, str]:
    """The topics of scans and of odometry; "" for odometry that is not of a topic."""
    named = {topic for topic in how.topics if types.get(topic) in (*_SCANS, ODOMETRY, *_POSES)}

    def chosen(kinds: Sequence[str]) -> str:
        wanted = {topic for topic in named if types[topic] in kinds}
        return only_topic(path, types, kinds, "`topics`", set(types) - wanted if wanted else ())

    has_odometry = how.odometry and how.frames is None
    by_name = [topic for topic in named if types[topic] in _POSES]
    topics = [topic for topic, kind in types.items() if kind == ODOMETRY]
    return chosen(_SCANS), (by_name[0] if by_name else chosen((ODOMETRY,)) if topics else "") * has_odometry


def _recording(path: Path, reader: AnyReader, of_scans: str, of_odometry: str, how: How) -> _Recording:
    """Read the messages of both topics and of the transforms; odometry of /tf without a topic of it."""
    out, uses_tree = _Recording(TransformTree(how.frames)), how.odometry and not of_odometry
    wanted = [c for c in reader.connections if c.topic in (of_scans, of_odometry) or c.msgtype in TRANSFORM_TYPES]
    for connection, record_ns, raw in _messages(reader, wanted, out):
        topic = connection.topic
        try:
            message: Any = reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # damaged bytes raise whatever they lead to
            out.refuse(topic, ValueError(f"cannot be read ({reason_of(error)})"))
            continue
        try:
            if connection.msgtype in TRANSFORM_TYPES:
                for fault in out.tree.take(topic, message, record_ns):
                    out.refuse(topic, fault)
                continue
            own_ns = checked_stamp("stamp", stamp_ns(message))
            if topic == of_scans:
                out.scans.append(_Stamped(own_ns, record_ns, message))
                out.lasers[frame_name(message.header.frame_id)] += 1
                continue
            at = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            out.odometry.append(_Stamped(own_ns, record_ns, planar(at.position, at.orientation)))
            out.robots[frame_name(getattr(message, "child_frame_id", ""))] += 1
        except ValueError as error:
            out.refuse(topic, error)
    for topic, has in ((of_scans, out.scans), (of_odometry, out.odometry)):
        if topic and not has:
            raise InputError(
                f"{path} {topic}", f"found no message that can be used: {out.refused.get(topic, ['none'])[0]}"
            )
    if uses_tree and (how.frames is not None or any(link.stamped for link in out.tree.links.values())):
        try:
            pair, rows = out.tree.odometry(out.laser, how.frames)
        except ValueError as error:
            raise InputError(f"{path} /tf", str(error)) from None
        out.robots[pair.child] += len(rows)
        out.odometry = [_Stamped(*row) for row in rows]
        out.found.append(Finding("odometry_frames", place=f"{pair}, {len(rows)} transforms"))
    return out


def _messages(reader: AnyReader, known: Sequence[Any], out: _Recording) -> Iterator[tuple[Any, int, bytes]]:
    """The messages of connections, up to the first damage of the file."""
    count = 0
    try:
        for each in reader.messages(connections=list(known)):
            yield each
            count += 1
    except Exception as error:
        if not count:
            raise
        text = f"the bag is damaged after {count} messages, which are read ({reason_of(error)})"
        out.found.append(Finding("cut_short", place=text))


def _own_frame(recording: _Recording) -> list[_Stamped]:
    """The scans of the frame that most scans have; those of others are counted."""
    for frame, count in recording.lasers.items():
        if frame != recording.laser:
            text = f"scans of {shown_name(frame)} are left out: most are of {shown_name(recording.laser)}"
            recording.found.append(Finding("left_out", count, place=text))
    return [each for each in recording.scans if frame_name(each.message.header.frame_id) == recording.laser]


def _describe(recording: _Recording, messages: Sequence[Any], reach: float) -> None:
    """Add what the messages say of the laser that cannot be as it is."""
    unlimited = sum(stated_reach(message) is None for message in messages)
    if unlimited:
        text = f"since range_max is not the range of a laser in {unlimited} of {len(messages)} scans"
        recording.found.append(Finding("assumed_range", reach, place=text))
    period_s = (
        float(np.median(passed_s([each.own_ns for each in recording.scans]))) if len(recording.scans) > 1 else 0.0
    )
    faults = [fault for message in messages if (fault := sweep_fault(message, period_s))]
    if faults:
        value = float(messages[0].time_increment) * (len(messages[0].ranges) - 1)
        recording.found.append(Finding("sweep", value, place=faults[0]))
    shares = [share for message in messages if (share := angles_disagree(message))]
    if 2 * len(shares) > len(messages):
        recording.found.append(Finding("angle_increment", float(np.median(shares))))


def _mount(path: Path, recording: _Recording, laser: LaserConfig, of_topic: bool) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    tree = recording.tree
    named = recording.robots.most_common(1)[0][0] if recording.robots else ""
    try:
        robot = named or tree.root(recording.laser)
        place = tree.mount(robot, recording.laser)
    except ValueError as error:
        raise InputError(f"{path} /tf_static", str(error)) from None
    if "mount" in laser.explicit_fields or any(laser.mount):
        return Pose(*laser.mount), place is not None and place[1]
    if place is None:
        there = ", ".join(map(shown_name, tree.frames()[:12])) or "none"
        between = f"nothing leads from {shown_name(robot)} to {shown_name(recording.laser)} (frames: {there})"
        recording.found.append(Finding("assumed_mount", place=f"the robot's centre, since {between}"))
    elif of_topic and not named:
        text = f"its place on {shown_name(robot)}, since odometry names no frame of the robot"
        recording.found.append(Finding("assumed_mount", place=text))
    return place or (Pose(), False)


def _log(recording: _Recording, made: Sequence[tuple[_Stamped, Any]], laser: LaserConfig, unit_m: float) -> Log:
    """The log, with stamps of the headers, or with those of the recording where the headers' do not ascend."""
    stamped = [each for each, _ in made], recording.odometry
    own = [_set(messages) for messages in stamped]
    headers = own[0].tolist()  # which relations refer to
    uses_records = not all(
        np.all(np.diff(stamps) >= 0) and len(np.unique(stamps)) > len(stamps) / 2 for stamps in own if len(stamps)
    )
    if uses_records:
        recording.found.append(Finding("stamps_of_recording", place="the headers decrease or repeat"))
        own = [np.array([each.record_ns for each in messages], dtype=np.int64) for messages in stamped]
    sightings = [
        Sighting(int(stamp) - sweep_ns(len(one.ranges), one.time_increment), one, header / 1e9)
        for stamp, header, (_, one) in zip(own[0].tolist(), headers, made, strict=True)
    ]
    odometry = None
    if recording.odometry:
        poses = np.array([each.message.array() for each in recording.odometry]) * (unit_m, unit_m, 1.0)
        odometry = Odometry(ascending(own[1]), poses)
    return Log.of(sightings, odometry, laser, recording.found)


def _set(messages: Sequence[_Stamped]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """(N,) stamps of headers, ns; of the recording where they are 0 among others that show the time, or all are 0."""
    own = np.array([each.own_ns for each in messages], dtype=np.int64)
    records = np.array([each.record_ns for each in messages], dtype=np.int64)
    is_unset = (own == 0) & (bool(len(own)) and (not own.any() or float(np.median(own)) > _SINCE_1970_NS))
    return np.where(is_unset, records, own)
