"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick
from sixthsense.sources.logs.bag_file import found_topic, only_topic, opened
from sixthsense.sources.logs.laser_geometry import FARTHEST_M, described, max_range_of
from sixthsense.sources.logs.log import Log, continued, found_turns, gaps_of, pose_between
from sixthsense.sources.logs.ros_messages import (
    LASER_SCAN,
    ODOMETRY,
    checked_stamp,
    frame_name,
    planar,
    scan,
    stamp_ns,
)
from sixthsense.sources.logs.text_lines import LogError
from sixthsense.sources.logs.transforms import OPTION, TRANSFORM_TYPES, FramePair, TransformTree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


def read_bag(
    file: str | Path,
    laser: LaserConfig,
    topics: Sequence[str] = (),
    frames: FramePair | None = None,
    odometry: bool = True,
    is_mount_given: bool = False,
) -> Log:
    """Read a bag: ROS 1 (.bag), or ROS 2 (a folder with metadata.yaml, an .mcap or a .db3 file).

    Scans and odometry are the topics of type LaserScan and Odometry; `topics` selects among several. Without a
    topic of Odometry, or with `frames`, odometry is a pair of frames in /tf; without transforms there, the log
    has scans alone, as without `odometry`. Beams and ranges come from the messages. The mount is `laser.mount`
    if it is not zero or `is_mount_given`, else that of /tf_static. Scans of another frame than the first are left out.
    Messages are sorted by the stamps of their headers if the stamps of each topic ascend, else they keep the order of
    the file. The stamp of a tick is at least 1 ns after the previous one. The odometry of a scan is interpolated at its
    stamp. The stamp of a sweep is that of its first beam in the message and of its last beam in the tick.
    Raises LogError for a bag that cannot be read, is damaged or truncated, or lacks a topic of scans.
    """
    path = Path(file)
    with opened(path) as reader:
        chosen = _choose(path, reader, topics, odometry and frames is None)
        recording = _recording(path, reader, chosen, frames, odometry and ODOMETRY not in chosen)
        return _log(path, recording, laser, is_mount_given)


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    records: list[tuple[int, Any]] = field(default_factory=list)
    """stamp of the header, ns, and T_odom_robot or the message of a scan"""
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

    @property
    def odometry(self) -> list[tuple[int, Pose]]:
        """The records of odometry alone."""
        return [(own, value) for own, value in self.records if isinstance(value, Pose)]

    @property
    def scans(self) -> list[tuple[int, Any]]:
        """The records of scans alone."""
        return [(own, value) for own, value in self.records if not isinstance(value, Pose)]


def _recording(
    path: Path, reader: AnyReader, chosen: Mapping[str, str], frames: FramePair | None, uses_tree: bool
) -> _Recording:
    """Read the messages of chosen topics; odometry of /tf if `uses_tree`; LogError for one that cannot be used."""
    recording = _Recording()
    known = [c for c in reader.connections if c.topic in chosen.values() or _has_transforms(c, uses_tree)]
    rows: dict[int, int] = {}  # of the transforms of /tf by their record
    for connection, record_ns, raw in reader.messages(connections=known):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype in TRANSFORM_TYPES:
            for row in recording.tree.take(str(path), connection.topic, message, record_ns):
                rows[len(recording.records)] = row
                recording.records.append((recording.tree.stamped[row][0], Pose()))
        elif connection.topic == chosen.get(connection.msgtype):
            own = checked_stamp(str(path), stamp_ns(message) or record_ns)  # some drivers leave the stamp at zero
            if connection.msgtype == LASER_SCAN:
                _add_scan(recording, own, message)
            else:
                _add_odometry(path, recording, own, message)
    if uses_tree and (recording.tree.stamped or frames is not None):
        _take_odometry(path, recording, rows, frames)
    elif ODOMETRY not in chosen and recording.scans:
        recording.has_odometry = False
        recording.robot = recording.tree.root(recording.laser)
        recording.records = [each for own, message in recording.scans for each in ((own, Pose()), (own, message))]
    if recording.has_odometry:
        recording.remarks += gaps_of(recording.odometry)
        poses, jumps = continued(recording.odometry)
        recording.remarks += jumps
        left = iter(poses)
        recording.records = [
            (own, next(left) if isinstance(value, Pose) else value) for own, value in recording.records
        ]
    return recording


def _has_transforms(connection: Any, with_moving: bool) -> bool:
    name = connection.topic
    return connection.msgtype in TRANSFORM_TYPES and (name.endswith("tf_static") or with_moving)


def _take_odometry(path: Path, recording: _Recording, rows: Mapping[int, int], named: FramePair | None) -> None:
    """Keep the transforms that are odometry."""
    try:
        pair, poses = recording.tree.odometry(recording.laser, named)
    except ValueError as error:
        raise LogError(f"{path} /tf: {error}") from None
    recording.robot = pair.child
    recording.records = [
        (own, poses[rows[k]] if k in rows else value)
        for k, (own, value) in enumerate(recording.records)
        if k not in rows or rows[k] in poses
    ]
    recording.remarks.append(f"odometry: /tf {pair}, {len(poses)} transforms (otherwise {OPTION})")


def _choose(path: Path, reader: AnyReader, topics: Sequence[str], with_odometry: bool) -> dict[str, str]:
    """The topic of each type; LogError with the candidates unless there is one, or one is selected."""
    types = {c.topic: c.msgtype for c in reader.connections}
    fitting = {kind: sorted(t for t, name in types.items() if name == kind) for kind in (LASER_SCAN, ODOMETRY)}
    for topic in topics:
        if types.get(topic) not in fitting:
            offered = sorted(itertools.chain(*fitting.values()))
            found = found_topic(topic, types, f"{topic!r}, no topic of {path}", offered, "allowed: none here")
            raise LogError(f"--topic: {found}")
    chosen = {}
    for kind, names in fitting.items():
        short = kind.rpartition("/")[2]
        if kind == ODOMETRY and not (names and with_odometry):
            continue
        if not names:
            held = (
                ", ".join(f"{shown_name(t)} ({shown_name(n.rpartition('/')[2])})" for t, n in sorted(types.items())[:8])
                or "no topic at all"
            )
            raise LogError(f"{path}: found no topic of type {short}, but {held}, allowed: a bag with one")
        chosen[kind] = only_topic(path, [name for name in names if name in topics] or names, f"type {short}", "--topic")
    return chosen


def _add_scan(recording: _Recording, own: int, message: Any) -> None:
    frame = frame_name(message.header.frame_id)
    recording.laser = recording.laser or frame
    if frame == recording.laser:
        recording.records.append((own, message))
    else:
        recording.other_frames[frame] += 1


def _add_odometry(path: Path, recording: _Recording, own: int, message: Any) -> None:
    recording.robot = recording.robot or frame_name(message.child_frame_id)
    try:
        pose = planar(message.pose.pose.position, message.pose.pose.orientation)
    except ValueError as error:
        raise LogError(f"{path} odometry {len(recording.odometry) + 1}: {error}") from None
    recording.records.append((own, pose))


def _log(path: Path, recording: _Recording, laser: LaserConfig, is_mount_given: bool) -> Log:
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
    if turns := found_turns(scans, recording.laser):
        raise LogError(f"{path}: {turns}")
    for frame, count in recording.other_frames.items():
        recording.remarks.append(
            f"{count} scans of {shown_name(frame)} are left out, since those of {shown_name(recording.laser)} "
            "are of another laser"
        )
    ticks = _ticks(path, recording, scans)
    return Log(ticks, described_laser(scans[0], laser), recording.remarks, recording.has_odometry)


def _mount(path: Path, recording: _Recording, laser: LaserConfig, is_given: bool) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    try:
        found = recording.tree.mount(recording.robot, recording.laser)
    except ValueError as error:
        raise LogError(f"{path} /tf_static: {error}") from None
    place, upside_down = found or (Pose(), False)
    if is_given or any(laser.mount):
        return Pose(*laser.mount), upside_down
    if found is None and recording.has_odometry:
        frames = f"{shown_name(recording.robot)} to {shown_name(recording.laser)}"
        recording.remarks.append(
            f"assumed: the laser at the robot's centre, since no /tf_static leads from {frames} "
            "(otherwise set laser.mount)"
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
    step, place = float(first.angle_increment), first.T_robot_laser
    return described(laser, len(first.ranges), step, first.max_range, place)


def _ticks(path: Path, recording: _Recording, scans: Sequence[Scan]) -> list[Tick]:
    """One tick per message, and one for odometry and scan with the same stamp, from the first odometry on."""
    odometry, stamped = recording.odometry, recording.scans
    left = iter(scans)
    entries: list[tuple[int, Pose | Scan, int]] = []  # time of the tick, pose or scan, stamp of the message
    for own, value in recording.records:
        made = value if isinstance(value, Pose) else next(left)
        ends = own if isinstance(made, Pose) else own - sweep_ns(len(made.ranges), made.time_increment)
        entries.append((ends, made, own))
    if _ascends(stamped) and _ascends(odometry):
        if stamped[0][0] > odometry[-1][0] or stamped[-1][0] < odometry[0][0]:
            spans = [f"{s[0][0] * 1e-9:.3f} to {s[-1][0] * 1e-9:.3f} s" for s in (stamped, odometry)]
            raise LogError(f"{path}: found scans from {spans[0]}, odometry from {spans[1]}, allowed: one clock")
        entries.sort(key=lambda entry: (entry[0], isinstance(entry[1], Scan)))
    ticks: list[Tick] = []
    clock, last = -1, -1
    for ends, made, own in entries:
        if isinstance(made, Pose):
            last += 1
            clock = max(ends, clock + 1)
            ticks.append(Tick(clock, made))
        elif ticks and ticks[-1].scan is None and ends == odometry[last][0]:
            ticks[-1] = replace(ticks[-1], scan=made, log_stamp_s=own / 1_000_000_000)
        elif ticks:  # else the pose of the robot is not known yet
            clock = max(ends, clock + 1)
            ticks.append(Tick(clock, _interpolate(odometry, last, ends), made, log_stamp_s=own / 1_000_000_000))
    if not any(tick.scan is not None for tick in ticks):
        raise LogError(f"{path}: found no scan after the first odometry, allowed: a log with both")
    return ticks


def _ascends(stamped: Sequence[tuple[int, Any]]) -> bool:
    return all(a[0] <= b[0] for a, b in itertools.pairwise(stamped))


def _interpolate(odometry: Sequence[tuple[int, Pose]], last: int, at_ns: int) -> Pose:
    """Odometry interpolated at a stamp between message `last` and the next; that of `last` for any other stamp."""
    before, after = odometry[last], odometry[min(last + 1, len(odometry) - 1)]
    return pose_between(before, after, at_ns) if before[0] < at_ns < after[0] else before[1]
