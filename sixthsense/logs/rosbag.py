"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.logs.bag_file import only_topic, opened, wrong_topic
from sixthsense.logs.joining import Stamped, joined, one_clock
from sixthsense.logs.laser_geometry import described, max_range_of
from sixthsense.logs.log import Log, continued, found_turns, gaps_of
from sixthsense.logs.refused import Refused
from sixthsense.logs.ros_messages import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    checked_stamp,
    frame_name,
    planar,
    ranges_of,
    scan,
    stamp_ns,
    stated_reach,
)
from sixthsense.logs.stamps import passed_s, tell_time
from sixthsense.logs.transforms import OPTION, TRANSFORM_TYPES, FramePair, TransformTree
from sixthsense.logs.units import SI, Units, check_odometry, check_ranges

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_SCANS = (LASER_SCAN, MULTI_ECHO)
_POSES = ("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped")


class How(NamedTuple):
    """How a bag is read."""

    topics: Sequence[str] = ()
    """of scans and odometry, among several"""
    frames: FramePair | None = None
    """of odometry in /tf"""
    odometry: bool = True
    """whether the bag's odometry is used"""
    is_mount_given: bool = False
    """whether `laser.mount` is used even if it is zero"""
    units: Units = SI
    """of the bag's numbers"""


def read_bag(file: str | Path, laser: LaserConfig, how: How | None = None) -> Log:
    """Read a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file).

    Scans and odometry are the topics of type LaserScan, or MultiEchoLaserScan, and Odometry. Without a topic of
    Odometry, or with `how.frames`, odometry is a pair of frames in /tf; without transforms there, the log has scans
    alone. Beams and ranges are those of each message. Scans are of the frame that most of them have. The mount is
    `laser.mount` if it is not zero or given, else that of /tf_static, or of /tf where it stands still.

    Messages are sorted by the stamps of their headers if the stamps of each topic ascend, else they keep the order of
    the file. The stamp of a tick is at least 1 ns after the previous one. The odometry of a scan is interpolated at its
    stamp. The stamp of a sweep is that of its first beam in the message and of its last beam in the tick. A message
    that cannot be used is left out, and counted in a remark. Raises InputError for a bag that cannot be read, that
    lacks a topic of scans or a scan that can be used, or that is in other units.
    """
    path, how = Path(file), how or How()
    remarks: list[str] = []
    with opened(path, remarks) as reader:
        chosen = _choose(path, reader, how.topics, how.odometry and how.frames is None)
        recording = _recording(path, reader, chosen, how, remarks)
        return _log(path, reader, recording, laser, how)


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    topics: Mapping[str, str]
    """`scan`, and `odometry` if there is a topic of it"""
    remarks: list[str]
    scans: list[tuple[int, int, int, Any]] = field(default_factory=list)
    """stamps of header and record, ns, the place in the file, and the message"""
    odometry: list[tuple[int, int, int, Pose]] = field(default_factory=list)
    """the same with `T_odom_robot`"""
    tree: TransformTree = field(default_factory=TransformTree)
    robots: Counter[str] = field(default_factory=Counter)
    """number of messages of odometry by the robot's frame"""
    lasers: Counter[str] = field(default_factory=Counter)
    """number of scans by frame"""
    refused: Refused = field(default_factory=Refused)
    totals: Counter[str] = field(default_factory=Counter)
    """number of messages by topic"""
    has_odometry: bool = True
    """whether the bag has odometry that is used; without it, the robot is said to stand at the first scan"""

    @property
    def robot(self) -> str:
        """The frame of the robot that most messages of odometry name; empty if they name none."""
        return self.robots.most_common(1)[0][0] if self.robots else ""

    @property
    def laser(self) -> str:
        """The frame of most scans."""
        return max(self.lasers, key=lambda name: (self.lasers[name], name))


def _recording(path: Path, reader: AnyReader, chosen: Mapping[str, str], how: How, remarks: list[str]) -> _Recording:
    """Read the messages of chosen topics; odometry of /tf without a topic of it."""
    out, uses_tree = _Recording(chosen, remarks), how.odometry and "odometry" not in chosen
    known = [c for c in reader.connections if c.topic in chosen.values() or _has_transforms(c, uses_tree)]
    rows: list[tuple[int, int, int, int]] = []  # stamps, place and row of the transforms of /tf
    for place, (connection, record_ns, raw) in enumerate(_messages(reader, known, out)):
        topic = connection.topic
        out.totals[topic] += 1
        try:
            message: Any = reader.deserialize(raw, connection.msgtype)
        except Exception as error:  # damaged bytes raise whatever they lead to
            out.refused.add(topic, ValueError(f"cannot be read ({reason_of(error)}), allowed: {connection.msgtype}"))
            continue
        try:
            if connection.msgtype in TRANSFORM_TYPES:
                found = out.tree.take(str(path), topic, message, record_ns, out.refused)
                rows += [(out.tree.stamped[row][0], record_ns, place, row) for row in found]
                continue
            checked_stamp(str(path), stamp_ns(message))
            if topic == chosen["scan"]:
                out.scans.append((stamp_ns(message), record_ns, place, message))
                out.lasers[frame_name(message.header.frame_id)] += 1
            else:
                at = message.pose.pose if hasattr(message.pose, "pose") else message.pose
                pose = planar(at.position, at.orientation)
                pose = Pose(how.units.odometry * pose.x, how.units.odometry * pose.y, pose.theta)
                out.odometry.append((stamp_ns(message), record_ns, place, pose))
                out.robots[frame_name(getattr(message, "child_frame_id", ""))] += 1
        except ValueError as error:
            out.refused.add(topic, error)
    if not out.scans:
        _without(path, out, chosen["scan"])
    if uses_tree and (out.tree.stamped or how.frames is not None):
        _take_odometry(path, out, rows, how.frames)
    elif "odometry" not in chosen:
        out.has_odometry = False
        out.robots[out.tree.root(out.laser)] += 1
        if how.odometry and (poses := sorted({c.topic for c in reader.connections if c.msgtype in _POSES})):
            names = ", ".join(map(shown_name, poses))
            remarks.append(f"no odometry, but poses: {names}; `topics` takes one of these as odometry")
    elif not out.odometry:
        _without(path, out, chosen["odometry"])
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
        out.remarks.append(f"the bag is damaged after {count} messages, which are read ({reason_of(error)})")


def _without(path: Path, recording: _Recording, topic: str) -> None:
    """Raise InputError for a topic without a message that can be used."""
    if recording.refused.count(topic):
        raise InputError(f"{path} {topic}", f"{recording.refused.first(topic)}")
    raise InputError(path, f"found no message on {shown_name(topic)}", "a log with scans and odometry")


def _has_transforms(connection: Any, with_moving: bool) -> bool:
    name = connection.topic
    return connection.msgtype in TRANSFORM_TYPES and (name.endswith("tf_static") or with_moving)


def _take_odometry(
    path: Path, recording: _Recording, rows: Sequence[tuple[int, int, int, int]], named: FramePair | None
) -> None:
    """Keep the transforms that are odometry."""
    try:
        pair, poses = recording.tree.odometry(recording.laser, named)
    except ValueError as error:
        raise InputError(f"{path} /tf", str(error)) from None
    recording.robots[pair.child] += len(poses)
    recording.odometry = [(own, record_ns, place, poses[row]) for own, record_ns, place, row in rows if row in poses]
    recording.remarks.append(f"odometry: /tf {pair}, {len(poses)} transforms (otherwise {OPTION})")


def _choose(path: Path, reader: AnyReader, topics: Sequence[str], with_odometry: bool) -> dict[str, str]:
    """The topic of scans, and that of odometry if there is one; InputError with the candidates if it is not clear.

    A topic of poses is odometry where it is named.
    """
    types = {c.topic: c.msgtype for c in reader.connections}
    kinds = {"scan": _SCANS, "odometry": (ODOMETRY,)}
    fitting = {what: sorted(t for t, name in types.items() if name in names) for what, names in kinds.items()}
    for what, names in fitting.items():  # a topic without a message is no choice beside one that has some
        fitting[what] = [name for name in names if reader.topics[name].msgcount] or names
    if named := [topic for topic in topics if types.get(topic) in _POSES]:
        fitting["odometry"] = named
    for topic in topics:
        if topic not in itertools.chain(*fitting.values()):
            offered = sorted(itertools.chain(*fitting.values()))
            raise wrong_topic("topics", topic, types, f"{topic!r}, no topic of {path}", offered, "none here")
    chosen = {}
    for what, names in fitting.items():
        short = kinds[what][0].rpartition("/")[2]
        if what == "odometry" and not (names and with_odometry):
            continue
        if not names:
            held = (
                ", ".join(f"{shown_name(t)} ({shown_name(n.rpartition('/')[2])})" for t, n in sorted(types.items())[:8])
                or "no topic at all"
            )
            raise InputError(path, f"found no topic of type {short}, but {held}", "a bag with one")
        chosen[what] = only_topic(
            path, [name for name in names if name in topics] or names, f"type {short}", "`topics`"
        )
    return chosen


def _log(path: Path, reader: AnyReader, recording: _Recording, laser: LaserConfig, how: How) -> Log:
    remarks = recording.remarks
    place, upside_down = _mount(path, reader, recording, laser, how.is_mount_given)
    scans = _scans(path, recording, place, upside_down != laser.mirrored, how.units)
    made = [each.value for each in scans if isinstance(each.value, Scan)]
    if not any((s.ranges <= np.float32(s.max_range)).any() for s in made):
        raise InputError(path, f"found no return in {len(made)} scans", "ranges from range_min to range_max")
    if turns := found_turns(made, recording.laser):
        raise InputError(path, turns)
    odometry = [each._replace(own_ns=each.end_ns, value=Pose()) for each in scans]
    if recording.has_odometry:
        odometry = _timed(recording.odometry, recording.topics.get("odometry", "/tf"), remarks)
    by_stamps = _ascends(scans) and _ascends(odometry)
    if recording.has_odometry:
        odometry = _without_jumps(path, recording, odometry)
        if by_stamps:
            try:
                scans, odometry = one_clock(scans, odometry, remarks)
            except ValueError as error:
                raise InputError(path, str(error)) from None
    remarks += recording.refused.remarks(recording.totals)
    own_s = [own / 1e9 for own in _headers(recording, scans)]
    ticks = joined(scans, odometry, own_s, by_stamps, remarks)
    return Log(ticks, described_laser(made, laser), remarks, recording.has_odometry)


def _headers(recording: _Recording, scans: Sequence[Stamped]) -> list[int]:
    """The stamps of the headers of scans, which relations refer to; of the records without one."""
    own = {place: header or record_ns for header, record_ns, place, _ in recording.scans}
    return [own[each.place] for each in scans]


def _timed(stamped: Sequence[tuple[int, int, int, Any]], topic: str, remarks: list[str]) -> list[Stamped]:
    """Messages with the stamps that put them in order: of their headers, or of their recording where these do not."""
    absent = sum(own == 0 != record_ns for own, record_ns, *_ in stamped)  # a clock may begin with 0
    own = [own or record_ns for own, record_ns, _, _ in stamped]
    if absent:
        remarks.append(f"{absent} of {len(own)} messages of {topic} have no stamp: the time of recording is theirs")
    records = [record_ns for _, record_ns, _, _ in stamped]
    if not tell_time(own) and tell_time(records):
        remarks.append(f"stamps of {topic} repeat: the times of recording are used")
        own = records
    return [Stamped(at, *each[1:]) for at, each in zip(own, stamped, strict=True)]


def _scans(path: Path, recording: _Recording, place: Pose, upside_down: bool, units: Units) -> list[Stamped]:
    """The scans of the frame that most scans have; those that cannot be used, and of other frames, are counted."""
    topic, remarks, found = recording.topics["scan"], recording.remarks, []
    own = [each for each in recording.scans if frame_name(each[3].header.frame_id) == recording.laser]
    check_ranges(str(path), [ranges_of(message, units) for *_, message in own])
    unlimited = [each[3] for each in own if stated_reach(each[3], units) is None]
    reach = max_range_of([ranges_of(message, units) for message in unlimited]) if unlimited else 0.0
    for each in _timed(own, topic, remarks):
        message: Any = each.value
        limit = reach if stated_reach(message, units) is None else None
        try:
            if limit == 0.0:
                raise ValueError("found range_max of no laser and no range, allowed: metres")
            found.append(each._replace(value=scan(message, place, upside_down, limit, units)))
        except ValueError as error:
            recording.refused.add(topic, error)
    if not found:
        _without(path, recording, topic)
    if unlimited:
        several = f" in {len(unlimited)} of {len(own)} scans" * (len(unlimited) < len(own))
        remarks.append(f"assumed: a laser of {reach:.2f} m, since range_max is not the range of a laser{several}")
    for frame, count in recording.lasers.items():
        if frame != recording.laser:
            remarks.append(
                f"{count} scans of {shown_name(frame)} are left out: most, {len(own)}, are of "
                f"{shown_name(recording.laser)}"
            )
    return found


def _without_jumps(path: Path, recording: _Recording, odometry: list[Stamped]) -> list[Stamped]:
    """Odometry that is `continued`; InputError where it is in other units."""
    stamped = [(each.own_ns, each.value) for each in odometry if isinstance(each.value, Pose)]
    if len(stamped) > 1:
        poses = np.array([pose.array() for _, pose in stamped])
        check_odometry(str(path), passed_s([own for own, _ in stamped]), poses)
    recording.remarks += gaps_of(stamped)
    continuous, jumps = continued(stamped)
    recording.remarks += jumps
    return [each._replace(value=pose) for each, pose in zip(odometry, continuous, strict=True)]


def _mount(
    path: Path, reader: AnyReader, recording: _Recording, laser: LaserConfig, is_given: bool
) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    tree, remarks = recording.tree, recording.remarks
    try:
        robot = _robot(recording)
        found = tree.mount(robot, recording.laser)
        if found is None and not tree.stamped and not (is_given or any(laser.mount)):
            known = [c for c in reader.connections if _has_transforms(c, True) and not _has_transforms(c, False)]
            for connection, record_ns, raw in _messages(reader, known, recording) if known else ():
                message = reader.deserialize(raw, connection.msgtype)
                tree.take(str(path), connection.topic, message, record_ns, recording.refused)
            robot = _robot(recording)
            found = tree.mount(robot, recording.laser)
        root = tree.root(recording.laser)
        from_root = tree.mount(root, recording.laser) if root != recording.laser else None
    except ValueError as error:
        raise InputError(f"{path} /tf_static", str(error)) from None
    if not recording.robot and recording.has_odometry and found is not None:
        remarks.append(
            f"odometry does not name the robot's frame: taken to be {shown_name(robot)}, the root of the frames that "
            f"lead to {shown_name(recording.laser)}"
        )
    place, upside_down = found or from_root or (Pose(), False)
    if is_given or any(laser.mount):
        return Pose(*laser.mount), upside_down
    if found is None and recording.has_odometry:
        frames = f"{shown_name(robot)} to {shown_name(recording.laser)}"
        there = ", ".join(map(shown_name, tree.frames()[:12])) or "none"
        where = f"where {shown_name(root)}, the root of its frames, has it" if from_root else "at the robot's centre"
        remarks.append(
            f"assumed: the laser {where}, since no constant transforms lead from {frames} "
            f"(frames: {there}; otherwise set `laser.mount`)"
        )
    return place, upside_down


def _robot(recording: _Recording) -> str:
    """The robot's frame as odometry names it, else the root of the frames that lead to the laser."""
    return recording.robot or recording.tree.root(recording.laser)


def described_laser(scans: Sequence[Scan], laser: LaserConfig) -> LaserConfig:
    """The configuration of the laser that took scans: of the beams and the range that most of them have."""
    kinds = Counter((len(s.ranges), float(s.angle_increment), s.max_range) for s in scans)
    (count, step, reach), _ = kinds.most_common(1)[0]
    return described(laser, count, step, reach, scans[0].T_robot_laser)


def _ascends(stamped: Sequence[Stamped]) -> bool:
    return all(a.own_ns <= b.own_ns for a, b in itertools.pairwise(stamped))
