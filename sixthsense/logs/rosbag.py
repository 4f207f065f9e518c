"""ROS 1 and ROS 2 bags, opened by rosbags within bounds: as a log of scans and odometry, and as poses of a topic."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError, nearest, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import sweep_ns
from sixthsense.logs import ros_messages as ros
from sixthsense.logs.finding import Finding
from sixthsense.logs.laser_geometry import FARTHEST_M, max_range_of
from sixthsense.logs.log import Log, Odometry, Sighting, ascending, passed_s

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_SCANS = (ros.LASER_SCAN, ros.MULTI_ECHO)
_SPREAD = "geometry_msgs/msg/PoseWithCovarianceStamped"
_STAMPED = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_SUFFIXES = {b"\x89MCAP0\r\n": ".mcap", b"#ROSBAG": ".bag", b"SQLite format 3\x00": ".db3"}
_WHOLE = "a whole ROS 1 .bag, ROS 2 folder or file; `rosbag reindex` mends a cut .bag, `mcap recover` a cut .mcap"
_BASE_BUDGET, _BUDGET_PER_BYTE = 1 << 28, 20
"""bytes that all chunks may have together; scans rarely compress to a tenth"""
_MCAP_END = b"\x0f\x04" + bytes(11) + b"\x02\x14" + bytes(27) + b"\x89MCAP0\r\n"
"""records DataEnd and Footer of a file without an index, and what each file ends with"""
_SINCE_1970_NS = 10**17
"""Stamps of a clock that shows the time are larger: one of 0 among them is not set."""


def suffix_of(file: Path) -> str:
    """The suffix that a bag has by its first bytes; empty for another file, and for one that cannot be read."""
    try:
        if not file.is_file():  # a pipe would wait for ever
            return ""
        with file.open("rb") as stream:
            begin = stream.read(16)
    except OSError:
        return ""
    return next((suffix for magic, suffix in _SUFFIXES.items() if begin.startswith(magic)), "")


def bag_files(folder: Path) -> list[Path]:
    """The files of a ROS 2 bag in a folder; pieces may be in any order."""
    return sorted(file for file in folder.iterdir() if suffix_of(file) in (".mcap", ".db3"))


@contextmanager
def _opened(path: Path, found: list[Finding]) -> Iterator[AnyReader]:
    """The reader of a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file); an MCAP file that is cut is found.

    Whatever is wrong within the block is an InputError: a damaged bag can raise any exception, and may define a type
    with a known name but without the expected fields.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with TemporaryDirectory() as folder:
            files = bag_files(path) if path.is_dir() else [path]
            for k, file in enumerate(files):
                if (kind := suffix_of(file)) not in ("", file.suffix):
                    raise InputError(file, "found a bag of another name", f"one that ends in {kind}")
                if kind == ".mcap" and (end := _whole_until(file)) is not None:
                    files[k] = Path(folder, file.name)
                    files[k].write_bytes(file.read_bytes()[:end] + _MCAP_END)
                    found.append(Finding("cut_short", place=f"{file.name} is cut short: its whole chunks are read"))
            named = [path] if (path / "metadata.yaml").is_file() and not found else files or [path]
            with AnyReader(named, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield reader
    except InputError:
        raise
    except Exception as error:
        raise InputError(path, f"cannot be read as a bag ({reason_of(error)})", _WHOLE) from None


def _whole_until(file: Path) -> int | None:
    """Where the last whole chunk of an MCAP file ends that is cut short; None for a whole file.

    Raises ValueError, by the headers of the records, for chunks that are far larger than the file.
    """
    from mcap.records import Chunk, Message
    from mcap.stream_reader import StreamReader

    end: int | None = 0
    left = _BASE_BUDGET + _BUDGET_PER_BYTE * file.stat().st_size
    with file.open("rb") as stream, suppress(Exception):  # whatever an incomplete record leads to
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=_BASE_BUDGET).records:
            left -= record.uncompressed_size if isinstance(record, Chunk) else 0
            end = stream.tell() if isinstance(record, (Chunk, Message)) else end
        end = None
    if left < 0:
        raise ValueError("found chunks that hold far more than the file")
    return end


def _topics_of(reader: AnyReader) -> dict[str, str]:
    """The type of each topic that has messages."""
    return {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}


class PoseTopic(NamedTuple):
    """The poses of a topic, in the order of its messages."""

    topic: str
    """its name"""
    stamps_ns: NDArray[np.int64]
    """(N,) of the headers; of the records where a driver leaves these at zero"""
    poses: Array
    """(N, 7), x y z qx qy qz qw"""
    covs: Array | None
    """(N, 6, 6), x y z and rotations about these axes of the parent frame; None of a type without covariance"""


def read_poses(path: Path, topic: str = "", with_covariance: bool = True, exclude: Collection[str] = ()) -> PoseTopic:
    """Read the poses of a topic, by default of the only one with poses, without those to `exclude`.

    Raises InputError with the candidates unless there is one, and for a bag or a pose that cannot be read.
    """
    kinds = (_SPREAD, ros.ODOMETRY) if with_covariance else (_SPREAD, ros.ODOMETRY, *_STAMPED)
    option = "`topic`" if with_covariance else "`truth_topic`"
    rows: list[list[float]] = []
    covs, stamps = [], []
    with _opened(path, []) as reader:
        types = {name: kind for name, kind in _topics_of(reader).items() if topic or name not in exclude}
        name = _only_topic(path, types, kinds, option, [topic] if topic else [])
        for connection, record_ns, raw in reader.messages([c for c in reader.connections if c.topic == name]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            try:
                rows.append(ros.pose_numbers(message))
            except ValueError as error:
                raise InputError(f"{path} {name} message {len(rows) + 1}", str(error)) from None
            stamps.append(ros.stamp_ns(message) or record_ns)
            covs += [] if connection.msgtype in _STAMPED else [message.pose.covariance]
    found = np.array(covs, dtype=np.float64).reshape(-1, 6, 6) if covs else None
    return PoseTopic(name, np.array(stamps, dtype=np.int64), np.array(rows, dtype=np.float64).reshape(-1, 7), found)


def _only_topic(path: Path, types: Mapping[str, str], kinds: Sequence[str], option: str, named: Sequence[str]) -> str:
    """The topic of these kinds that is named, or the only one.

    Raises InputError with the candidates for none or several.
    """
    every = sorted(topic for topic, kind in types.items() if kind in kinds)
    fitting = [topic for topic in every if not named or topic in named]
    if len(fitting) == 1:
        return fitting[0]
    short = {kind: kind.rpartition("/")[2] for kind in (*kinds, *types.values())}
    of_type = f"of type {' or '.join(short[kind] for kind in kinds)}"
    there = ", ".join(f"{shown_name(topic)} ({short[kind]})" for topic, kind in sorted(types.items())[:8])
    none = f"found no topic {', '.join(map(repr, named)) or of_type}, but {there or 'no topic at all'}"
    found = f"found {len(fitting)} topics {of_type}" if fitting else none
    allowed = f"one, by {option} {' or '.join(map(shown_name, fitting or every))}" if every else f"one {of_type}"
    raise InputError(path, found, allowed, nearest(next(iter(named), ""), every))


class _Stamped(NamedTuple):
    """A message with its stamps."""

    own_ns: int
    """of its header"""
    record_ns: int
    value: Any
    """the scan, or `T_odom_robot`"""
    frame: str
    """of the laser, or of the robot"""
    message: Any = None
    """of a scan"""


@dataclass(slots=True)
class _Recording:
    """The messages of a bag in the order of its records."""

    tree: ros.TransformTree = field(default_factory=ros.TransformTree)
    found: list[Finding] = field(default_factory=list)
    scans: list[_Stamped] = field(default_factory=list)
    odometry: list[_Stamped] = field(default_factory=list)
    refused: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    """what is wrong with messages that are left out, by topic"""


def read_bag(
    file: str | Path, laser: LaserConfig, topics: Sequence[str] = (), frames: Sequence[str] = (), odometry: bool = True
) -> Log:
    """Read a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file).

    Scans and odometry are the topics of type LaserScan, or MultiEchoLaserScan, and Odometry. Without a topic of
    odometry, or with `frames`, it is a transform of /tf; without one that moves there, or without `odometry`, the log
    has scans alone. Beams and ranges are those of each message. Scans are of the frame that most of them have. The
    mount is `laser.mount` if it is stated, else that of /tf_static, or of /tf where it stands still.

    Stamps are those of the headers, of the recording where these are not set or do not ascend. The stamp of a sweep is
    that of its first beam in the message and of its last beam in the tick. A message that cannot be used is left out,
    and counted. Raises InputError for a bag that cannot be read, that lacks a topic of scans or a scan that can be
    used, or whose odometry in /tf is not clear.
    """
    path, recording = Path(file), _Recording()
    named = ros.FramePair(*map(ros.frame_name, frames)) if len(frames) == 2 else None
    if frames and named is None:
        raise InputError("odometry_frames", f"found {','.join(frames)!r}", "PARENT,CHILD, such as odom,base_link")
    with _opened(path, recording.found) as reader:
        of_odometry = _read(path, reader, recording, topics, odometry and not frames)
    counts = Counter(each.frame for each in recording.scans)
    frame = max(counts, key=lambda name: (counts[name], name))
    if others := ", ".join(shown_name(name) for name in counts if name != frame):
        text = f"scans of {others} are left out: most are of {shown_name(frame)}"
        recording.found.append(Finding("left_out", len(recording.scans) - counts[frame], place=text))
        recording.scans = [each for each in recording.scans if each.frame == frame]
    try:
        if odometry and not of_odometry and (pair := recording.tree.odometry(frame, named)) is not None:
            recording.odometry = [_Stamped(*row, pair.child) for row in recording.tree.links[pair].stamped]
            recording.found.append(Finding("odometry_frames", place=f"{pair}, {len(recording.odometry)} transforms"))
        place, is_upside_down = _mount(recording, laser, frame)
    except ValueError as error:
        raise InputError(f"{path} /tf", str(error)) from None
    _describe(recording)
    unlimited = [each.value.ranges for each in recording.scans if each.value.max_range >= FARTHEST_M]
    is_stated = "max_range" in laser.model_fields_set
    limit = FARTHEST_M if not unlimited else laser.max_range if is_stated else max_range_of(unlimited)
    if unlimited and not is_stated:
        text = f"since range_max is not the range of a laser in {len(unlimited)} of {len(recording.scans)} scans"
        recording.found.append(Finding("assumed_range", limit, place=text))
    for k, each in enumerate(recording.scans):
        seen = replace(each.value, max_range=min(each.value.max_range, limit), T_robot_laser=place)
        is_mirrored = is_upside_down != laser.mirrored
        recording.scans[k] = each._replace(value=seen.mirrored() if is_mirrored else seen)
    return _log(recording, laser)


def _read(path: Path, reader: AnyReader, recording: _Recording, topics: Sequence[str], has_odometry: bool) -> str:
    """Read the messages of scans, odometry and transforms; the topic of odometry, "" where it is not of a topic."""
    types = _topics_of(reader)
    known = (*_SCANS, ros.ODOMETRY)
    if unknown := [topic for topic in topics if types.get(topic) not in known]:
        _only_topic(path, types, known, "`topics`", unknown)
    named = [topic for topic in topics if types[topic] in _SCANS]
    of_scans = _only_topic(path, types, _SCANS, "`topics`", named)
    named, of_odometry = [topic for topic in topics if types[topic] not in _SCANS], ""
    if has_odometry and ros.ODOMETRY in types.values():
        of_odometry = _only_topic(path, types, [ros.ODOMETRY], "`topics`", named)
    wanted = [c for c in reader.connections if c.topic in (of_scans, of_odometry) or c.msgtype in _TRANSFORMS]
    for connection, record_ns, raw in reader.messages(wanted):
        topic = connection.topic
        try:
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype in _TRANSFORMS:
                recording.tree.take(topic, message, record_ns)
                continue
            stamps = ros.stamp_ns(message), record_ns
            if topic == of_scans:
                limit = FARTHEST_M if ros.stated_reach(message) is None else None
                scan, frame = ros.scan(message, Pose(), limit), ros.frame_name(message.header.frame_id)
                recording.scans.append(_Stamped(*stamps, scan, frame, message))
            else:
                pose, child = ros.planar(message), ros.frame_name(message.child_frame_id)
                recording.odometry.append(_Stamped(*stamps, pose, child))
        except Exception as error:  # damaged bytes raise whatever they lead to
            recording.refused[topic].append(reason_of(error))
    for topic, has in ((of_scans, recording.scans), (of_odometry, recording.odometry)):
        if topic and not has:
            reason = (recording.refused[topic] or ["none"])[0]
            raise InputError(f"{path} {topic}", f"found no message that can be used: {reason}")
    return of_odometry


def _mount(recording: _Recording, laser: LaserConfig, frame: str) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    tree, named = recording.tree, Counter(each.frame for each in recording.odometry).most_common(1)
    robot = (named[0][0] if named else "") or tree.root(frame)
    place, assumed = tree.mount(robot, frame), ""
    if "mount" in laser.model_fields_set or any(laser.mount):
        return Pose(*laser.mount), place is not None and place[1]
    if place is None:
        there = ", ".join(map(shown_name, tree.frames()[:12])) or "none"
        lacks = f"nothing leads from {shown_name(robot)} to {shown_name(frame)} (frames: {there})"
        assumed = f"the robot's centre, since {lacks}"
    elif named and not named[0][0]:
        assumed = f"its place on {shown_name(robot)}, since odometry names no frame of the robot"
    recording.found += [Finding("assumed_mount", place=assumed)] if assumed else []
    return place or (Pose(), False)


def _describe(recording: _Recording) -> None:
    """Add what the messages say of the laser that cannot be as it is, and the messages that are left out."""
    scans = recording.scans
    period_s = float(np.median(passed_s([each.own_ns for each in scans]))) if len(scans) > 1 else 0.0
    for each in scans:
        if fault := ros.sweep_fault(each.message, period_s):
            value = float(each.message.time_increment) * (len(each.message.ranges) - 1)
            recording.found.append(Finding("sweep", value, place=fault))
            break
    shares = [share for each in scans if (share := ros.angles_disagree(each.message))]
    if 2 * len(shares) > len(scans):
        recording.found.append(Finding("angle_increment", float(np.median(shares))))
    for topic, reasons in recording.refused.items():
        text = f"messages of {topic} are left out, the first: {''.join(reasons[:1])}"
        recording.found += [Finding("left_out", len(reasons), place=text)] if reasons else []


def _log(recording: _Recording, laser: LaserConfig) -> Log:
    """The log, with stamps of the headers, or with those of the recording where these do not ascend, or are not set."""
    seen, driven = recording.scans, recording.odometry
    scans_ns, odometry_ns = (np.array([each.own_ns for each in one], dtype=np.int64) for one in (seen, driven))
    if is_unset := any(_is_unset(each) for each in (scans_ns, odometry_ns) if len(each)):
        recording.found.append(Finding("stamps_of_recording"))
        scans_ns, odometry_ns = (np.array([each.record_ns for each in one], dtype=np.int64) for one in (seen, driven))
    sightings = []
    for stamp, (own_ns, record_ns, scan, *_) in zip(scans_ns.tolist(), seen, strict=True):
        own_s = (own_ns or record_ns * is_unset) / 1e9
        sightings.append(Sighting(stamp - sweep_ns(len(scan.ranges), scan.time_increment), scan, own_s))
    odometry = Odometry(ascending(odometry_ns), np.array([each.value.array() for each in driven])) if driven else None
    return Log.of(sightings, odometry, laser, recording.found)


def _is_unset(own_ns: NDArray[np.int64]) -> bool:
    """Whether stamps of headers decrease, repeat for the most part, or are 0 among others that show the time."""
    is_zero = bool((own_ns == 0).any()) and float(own_ns.max()) > _SINCE_1970_NS
    return bool((np.diff(own_ns) < 0).any()) or 2 * len(np.unique(own_ns)) <= len(own_ns) > 1 or is_zero
