"""ROS 1 and ROS 2 bags: opened by rosbags within bounds, and the poses of a topic or of a pair of frames."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError, nearest, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array
from sixthsense.logs.ros_messages import ODOMETRY, pose_numbers, stamp_ns
from sixthsense.logs.text_lines import check_regular

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

WITH_COVARIANCE = ("geometry_msgs/msg/PoseWithCovarianceStamped", ODOMETRY)
WITHOUT = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")

_SUFFIXES = {b"\x89MCAP0\r\n": ".mcap", b"#ROSBAG": ".bag", b"SQLite format 3\x00": ".db3"}
_REPAIRED = {".mcap": "mcap recover", ".bag": "rosbag reindex"}
_LARGEST_CHUNK = 1 << 28  # bytes; writers close chunks after some millions
_BASE_BUDGET, _BUDGET_PER_BYTE = 1 << 30, 20
"""bytes that all chunks may have together; scans rarely compress to a tenth"""


def suffix_of(file: Path) -> str:
    """The suffix that a bag has by its first bytes; empty for another file, and for one that cannot be read."""
    try:
        if not file.is_file():
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
def opened(path: Path) -> Iterator[AnyReader]:
    """The reader of a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file).

    Whatever is wrong within the block is an InputError: a damaged bag can raise any exception, and may define a type
    with a known name but without the expected fields.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise InputError(path, "no such file")
    allowed = "ROS 1 .bag, ROS 2 folder or file"
    try:
        check_regular(path)
        files = bag_files(path) if path.is_dir() else [path]
        for file in files:
            if (kind := suffix_of(file)) not in ("", file.suffix):
                raise InputError(file, "found a bag of another name", f"one that ends in {kind}")
            if kind in _REPAIRED:
                allowed = f"a whole file; `{_REPAIRED[kind]}` makes one of it"
            if kind == ".mcap":
                _check_chunks(file)
        named = [path] if (path / "metadata.yaml").is_file() else files or [path]
        with AnyReader(named, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:
        raise InputError(path, f"cannot be read as a bag ({reason_of(error)})", allowed) from None


def _check_chunks(file: Path) -> None:
    """Raise an exception for a chunk larger than any writer's, for chunks far larger than the file, or a cut."""
    left = _BASE_BUDGET + _BUDGET_PER_BYTE * file.stat().st_size
    with file.open("rb") as stream:
        for held in _mcap_chunks(stream):
            left -= held
            if held > _LARGEST_CHUNK or left < 0:
                raise ValueError(f"found chunks that hold {held} bytes and more, far more than the file")


def _mcap_chunks(stream: IO[bytes]) -> Iterator[int]:
    """Bytes that each chunk of an MCAP file holds, by the headers of its records; an exception for a cut."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    try:
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=_LARGEST_CHUNK).records:
            if isinstance(record, Chunk):
                yield record.uncompressed_size
    except EndOfFile:
        raise ValueError("it is cut short") from None


@dataclass(slots=True)
class PoseTopic:
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
    kinds = WITH_COVARIANCE if with_covariance else (*WITH_COVARIANCE, *WITHOUT)
    rows, covs, stamps = [], [], []
    with opened(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}
        if topic:
            exclude = [name for name in types if name != topic]
        option = "`topic`" if with_covariance else "`truth_topic`"
        name = only_topic(path, types, kinds, option, exclude, f"no topic {topic!r}" if topic else "no topic of poses")
        for connection, record_ns, raw in reader.messages([c for c in reader.connections if c.topic == name]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            one = message.pose if hasattr(message, "pose") else message.transform
            try:
                stamps.append(stamp_ns(message) or record_ns)
                rows.append(pose_numbers(one.pose if hasattr(one, "pose") else one))
            except ValueError as error:
                raise InputError(f"{path} {name} message {len(stamps)}", str(error)) from None
            covs += [one.covariance] if connection.msgtype in WITH_COVARIANCE else []
    found = np.array(covs, dtype=np.float64).reshape(-1, 6, 6) if covs else None
    poses = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return PoseTopic(name, np.array(stamps, dtype=np.int64), poses, found)


def only_topic(
    path: Path,
    types: Mapping[str, str],
    kinds: Sequence[str],
    option: str,
    exclude: Collection[str] = (),
    missing: str = "no topic",
) -> str:
    """The only topic of these types but for those to `exclude`; InputError with the candidates for none or several."""
    every = sorted(topic for topic, kind in types.items() if kind in kinds)
    fitting = [topic for topic in every if topic not in exclude]
    if len(fitting) == 1:
        return fitting[0]
    names = ", ".join(kind.rpartition("/")[2] for kind in kinds)
    if fitting:
        allowed = f"one, by {option} {' or '.join(map(shown_name, fitting))}"
        raise InputError(path, f"found {len(fitting)} topics of type {names}", allowed)
    there = [f"{shown_name(topic)} ({kind.rpartition('/')[2]})" for topic, kind in sorted(types.items())[:8]]
    found = f"found {missing}, but {', '.join(there) or 'no topic at all'}"
    raise InputError(
        path, found, ", ".join(map(shown_name, every)) or f"a topic of type {names}", nearest(missing, every)
    )
