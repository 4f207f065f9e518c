"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.logs.bag_file import only_topic, opened
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.logs.laser_geometry import max_range_of
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    angles_disagree,
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

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

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


class _Stamped(NamedTuple):
    """A message with its stamps."""

    own_ns: int
    """of its header"""
    record_ns: int
    message: Any
    """a scan, or `T_odom_robot`"""
    frame: str
    """of the laser, or of the robot"""


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    tree: TransformTree
    found: list[Finding] = field(default_factory=list)
    scans: list[_Stamped] = field(default_factory=list)
    odometry: list[_Stamped] = field(default_factory=list)
    refused: dict[str, list[str]] = field(default_factory=dict)
    """what is wrong with messages that are left out, by topic"""

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
        of_scans, of_odometry = _topics(path, reader, how)
        recording = _recording(path, reader, of_scans, of_odometry, how)
    frames = Counter(each.frame for each in recording.scans)
    frame = max(frames, key=lambda name: (frames[name], name))
    own = [each for each in recording.scans if each.frame == frame]
    if len(own) < len(recording.scans):
        others = ", ".join(shown_name(name) for name in frames if name != frame)
        text = f"scans of {others} are left out: most are of {shown_name(frame)}"
        recording.found.append(Finding("left_out", len(recording.scans) - len(own), place=text))
    if how.odometry and not of_odometry:
        _add_odometry_of_tf(path, recording, frame, how.frames)
    place, is_upside_down = _mount(path, recording, laser, frame)
    unlimited = [ranges_of(each.message) for each in own if stated_reach(each.message) is None]
    limit = max_range_of(unlimited) if unlimited else None
    made: list[tuple[_Stamped, Scan]] = []
    for each in own:
        reach = limit if stated_reach(each.message) is None else None
        try:
            made.append((each, scan(each.message, place, is_upside_down != laser.mirrored, reach)))
        except ValueError as error:
            recording.refuse(of_scans, error)
    if not made:
        raise InputError(f"{path} {of_scans}", f"found no scan that can be used: {recording.refused[of_scans][0]}")
    if limit is not None:
        text = f"since range_max is not the range of a laser in {len(unlimited)} of {len(own)} scans"
        recording.found.append(Finding("assumed_range", limit, place=text))
    _describe(recording, [each for each, _ in made])
    return _log(recording, made, laser)


def _topics(path: Path, reader: AnyReader, how: How) -> tuple[str, str]:
    """The topics of scans and of odometry; "" for odometry that is not of a topic."""
    types = {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}
    types = types or {c.topic: c.msgtype for c in reader.connections}
    known = (*_SCANS, ODOMETRY, *_POSES)
    for topic in how.topics:
        only_topic(path, types, known, "`topics`", set(types) - {topic}, f"no topic {topic!r}")

    def chosen(kinds: Sequence[str]) -> str:
        wanted = {topic for topic in how.topics if types[topic] in kinds}
        return only_topic(path, types, kinds, "`topics`", set(types) - wanted if wanted else ())

    if not how.odometry or how.frames is not None:
        return chosen(_SCANS), ""
    poses = [topic for topic in how.topics if types[topic] in _POSES]
    return chosen(_SCANS), poses[0] if poses else chosen((ODOMETRY,)) if ODOMETRY in types.values() else ""


def _recording(path: Path, reader: AnyReader, of_scans: str, of_odometry: str, how: How) -> _Recording:
    """Read the messages of both topics and of the transforms."""
    out = _Recording(TransformTree(how.frames))
    wanted = [c for c in reader.connections if c.topic in (of_scans, of_odometry) or c.msgtype in TRANSFORM_TYPES]
    for connection, record_ns, raw in _messages(reader, wanted, out):
        topic = connection.topic
        try:
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype in TRANSFORM_TYPES:
                for fault in out.tree.take(topic, message, record_ns):
                    out.refuse(topic, fault)
            elif topic == of_scans:
                frame = frame_name(message.header.frame_id)
                out.scans.append(_Stamped(stamp_ns(message), record_ns, message, frame))
            else:
                pose = planar(message.pose.pose if hasattr(message.pose, "pose") else message.pose)
                robot = frame_name(getattr(message, "child_frame_id", ""))
                out.odometry.append(_Stamped(stamp_ns(message), record_ns, pose, robot))
        except Exception as error:  # damaged bytes raise whatever they lead to
            out.refuse(topic, error)
    for topic, has in ((of_scans, out.scans), (of_odometry, out.odometry)):
        if topic and not has:
            reason = out.refused.get(topic, ["none"])[0]
            raise InputError(f"{path} {topic}", f"found no message that can be used: {reason}")
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


def _add_odometry_of_tf(path: Path, recording: _Recording, laser: str, frames: FramePair | None) -> None:
    """Add the odometry of /tf, if there are any transforms."""
    tree = recording.tree
    if frames is None and not any(link.stamped for link in tree.links.values()):
        return
    try:
        pair, rows = tree.odometry(laser, frames)
    except ValueError as error:
        raise InputError(f"{path} /tf", str(error)) from None
    recording.odometry = [_Stamped(*row, pair.child) for row in rows]
    recording.found.append(Finding("odometry_frames", place=f"{pair}, {len(rows)} transforms"))


def _describe(recording: _Recording, own: Sequence[_Stamped]) -> None:
    """Add what the messages say of the laser that cannot be as it is, and the messages that are left out."""
    period_s = float(np.median(passed_s([each.own_ns for each in own]))) if len(own) > 1 else 0.0
    faults = [(each.message, fault) for each in own if (fault := sweep_fault(each.message, period_s))]
    if faults:
        message, fault = faults[0]
        value = float(message.time_increment) * (len(message.ranges) - 1)
        recording.found.append(Finding("sweep", value, place=fault))
    shares = [share for each in own if (share := angles_disagree(each.message))]
    if 2 * len(shares) > len(own):
        recording.found.append(Finding("angle_increment", float(np.median(shares))))
    for topic, reasons in recording.refused.items():
        text = f"messages of {topic} are left out, the first: {reasons[0]}"
        recording.found.append(Finding("left_out", len(reasons), place=text))


def _mount(path: Path, recording: _Recording, laser: LaserConfig, frame: str) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    tree, named = recording.tree, Counter(each.frame for each in recording.odometry).most_common(1)
    try:
        robot = (named[0][0] if named else "") or tree.root(frame)
        place = tree.mount(robot, frame)
    except ValueError as error:
        raise InputError(f"{path} /tf_static", str(error)) from None
    if "mount" in laser.model_fields_set or any(laser.mount):
        return Pose(*laser.mount), place is not None and place[1]
    if place is None:
        there = ", ".join(map(shown_name, tree.frames()[:12])) or "none"
        between = f"nothing leads from {shown_name(robot)} to {shown_name(frame)} (frames: {there})"
        recording.found.append(Finding("assumed_mount", place=f"the robot's centre, since {between}"))
    elif named and not named[0][0]:
        text = f"its place on {shown_name(robot)}, since odometry names no frame of the robot"
        recording.found.append(Finding("assumed_mount", place=text))
    return place or (Pose(), False)


def _log(recording: _Recording, made: Sequence[tuple[_Stamped, Scan]], laser: LaserConfig) -> Log:
    """The log, with stamps of the headers, or with those of the recording where the headers' do not ascend."""
    stamped = [each for each, _ in made], recording.odometry
    headers, of_odometry = (_set(messages) for messages in stamped)  # the headers' are those that relations refer to
    stamps = headers
    if not all(
        np.all(np.diff(each) >= 0) and len(np.unique(each)) > len(each) / 2
        for each in (headers, of_odometry)
        if len(each)
    ):
        recording.found.append(Finding("stamps_of_recording", place="the headers decrease or repeat"))
        stamps, of_odometry = (np.array([m.record_ns for m in messages], dtype=np.int64) for messages in stamped)
    sightings = [
        Sighting(int(stamp) - sweep_ns(len(one.ranges), one.time_increment), one, header / 1e9)
        for stamp, header, (_, one) in zip(stamps.tolist(), headers.tolist(), made, strict=True)
    ]
    odometry = None
    if recording.odometry:
        poses = np.array([each.message.array() for each in recording.odometry])
        odometry = Odometry(ascending(of_odometry), poses)
    return Log.of(sightings, odometry, laser, recording.found)


def _set(messages: Sequence[_Stamped]) -> NDArray[np.int64]:
    """(N,) stamps of headers, ns; of the recording where they are 0 among others that show the time, or all are 0."""
    own = np.array([each.own_ns for each in messages], dtype=np.int64)
    records = np.array([each.record_ns for each in messages], dtype=np.int64)
    is_unset = (own == 0) & (bool(len(own)) and (not own.any() or float(np.median(own)) > _SINCE_1970_NS))
    return np.where(is_unset, records, own)
