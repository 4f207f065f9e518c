"""ROS 1 and ROS 2 bags: opened within bounds, one topic of several, and poses of a topic or of a pair of frames."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError, nearest, reason_of
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array
from sixthsense.logs.bag_forms import readable, suffix_of
from sixthsense.logs.ros_messages import ODOMETRY, checked_stamp, frame_name, stamp_ns
from sixthsense.logs.text_lines import LARGEST, check_regular
from sixthsense.logs.transforms import TRANSFORM_TYPES, FramePair, TransformTree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

WITH_COVARIANCE = ("geometry_msgs/msg/PoseWithCovarianceStamped", ODOMETRY)
WITHOUT = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")

_LARGEST_CHUNK = 1 << 28  # bytes; writers close chunks after some millions
_BASE_BUDGET = 1 << 30  # bytes that all chunks of any bag may have together
_BUDGET_PER_BYTE = 20  # additional bytes per byte of the file; scans rarely compress to a tenth


@contextmanager
def opened(path: Path, remarks: list[str] | None = None) -> Iterator[AnyReader]:
    """The reader of a bag: ROS 1, or ROS 2 (a folder, an MCAP or a SQLite file), recognised by its first bytes.

    What was done about the form of the bag is added to the remarks. Whatever is wrong within the block is an
    InputError: a damaged bag can raise any exception, and may define a type with a known name but without the expected
    fields.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise InputError(path, "no such file")
    try:
        check_regular(path)
        _check_first_line(path)
        store = get_typestore(Stores.ROS2_HUMBLE)
        with (
            bounded(path),
            readable(path, partial(decompressed, is_whole=False), [] if remarks is None else remarks) as paths,
            AnyReader(paths, default_typestore=store) as reader,
        ):
            yield reader
    except InputError:
        raise
    except Exception as error:
        allowed = "ROS 1 .bag, ROS 2 folder or file"
        if suffix_of(path) == ".bag":
            allowed = "a whole ROS 1 bag; `rosbag reindex` makes one of what was cut short"
        raise InputError(path, f"cannot be read as a bag ({reason_of(error)})", allowed) from None


def _check_first_line(path: Path) -> None:
    """Raise ValueError for a ROS 1 bag with an endless first line, which the reader would read as a whole."""
    if path.is_file() and (path.suffix.lower() == ".bag" or suffix_of(path) == ".bag"):
        with path.open("rb") as stream:
            if not stream.readline(32).endswith(b"\n"):
                raise ValueError("File magic is invalid.")


@contextmanager
def bounded(path: Path) -> Iterator[None]:
    """A context in which rosbags raises ValueError if one chunk of a bag, or all of them together, get too large.

    rosbags decompresses a chunk again whenever messages of two chunks alternate, so the bound on the sum also bounds
    the time.
    """
    from rosbags.rosbag1 import reader as reader1
    from rosbags.rosbag2 import reader as reader2
    from rosbags.rosbag2 import storage_mcap

    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    left = _BASE_BUDGET + _BUDGET_PER_BYTE * sum(file.stat().st_size for file in files)

    def charge(data: bytes, _: int = 0) -> bytes:
        nonlocal left
        left -= len(data)
        if len(data) > _LARGEST_CHUNK:
            raise ValueError(f"found a chunk of over {_LARGEST_CHUNK} bytes")
        if left < 0:
            raise ValueError("found chunks that hold far more than the file")
        return data

    def decompressor(name: str) -> Callable[..., bytes]:
        return lambda data, _=0: charge(decompressed(data, name))

    @contextmanager
    def opened(stream: IO[bytes], mode: str) -> Iterator[Any]:
        with reading(stream, mode) as inner:
            yield SimpleNamespace(read=lambda size: charge(inner.read(size)))

    reading = vars(reader2)["zstd"].open
    tables: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        (
            storage_mcap.DECOMPRESSORS,
            {"": charge, "lz4": decompressor("lz4"), "zstd": decompressor("zstd")},
        ),
        (
            reader1.decompressors,
            {"none": charge, "lz4": decompressor("lz4"), "bz2": decompressor("bz2")},
        ),
        (vars(reader2), {"zstd": SimpleNamespace(decompress=decompressor("zstd"), open=opened)}),
    )
    before = [{name: table[name] for name in replacements} for table, replacements in tables]
    for table, replacements in tables:
        table.update(replacements)
    try:
        yield
    finally:
        for (table, _), originals in zip(tables, before, strict=True):
            table.update(originals)


def decompressed(data: bytes, compression: str, is_whole: bool = True) -> bytes:
    """Decompress concatenated bz2, lz4 or zstd streams; an empty `compression` returns the data unchanged.

    Raises ValueError for more data than a chunk may hold, for truncated data if it should be whole and for an unknown
    compression.
    """
    from backports import zstd
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    if not compression:
        return data
    kinds: dict[str, Callable[[], Any]] = {
        "bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor
    }  # fmt: skip
    if compression not in kinds:
        raise ValueError(f"found the compression {compression!r}, allowed: {', '.join(kinds)}")
    parts: list[bytes] = []
    size, rest = 0, data
    while rest:
        stream = kinds[compression]()
        parts.append(stream.decompress(rest, _LARGEST_CHUNK + 1 - size))
        size += len(parts[-1])
        if size > _LARGEST_CHUNK:
            raise ValueError(f"found a chunk of over {_LARGEST_CHUNK} bytes")
        if not stream.eof:
            if is_whole:
                raise ValueError("found compressed data that is cut short")
            break
        rest = stream.unused_data
    return b"".join(parts)


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
    parent: str
    """name of the frame in which the poses are"""
    child: str
    """name of the frame whose poses they are; empty where the type does not say"""


def read_poses(path: Path, topic: str = "", with_covariance: bool = True, exclude: Collection[str] = ()) -> PoseTopic:
    """Read the poses of a topic, by default of the only one with poses, without those to `exclude`.

    Raises InputError with the candidates unless there is one, and for a bag or a pose that cannot be read.
    """
    kinds = WITH_COVARIANCE if with_covariance else (*WITH_COVARIANCE, *WITHOUT)
    rows: list[list[float]] = []
    covs: list[Any] = []
    stamps: list[int] = []
    parent = child = ""
    with opened(path) as reader:
        name = _chosen(path, reader, topic, kinds, exclude)
        for connection, record_ns, raw in reader.messages([c for c in reader.connections if c.topic == name]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamps.append(checked_stamp(f"{path} {name}", stamp_ns(message) or record_ns))
            parent = parent or frame_name(message.header.frame_id)
            if connection.msgtype in WITH_COVARIANCE:
                rows.append(_numbers(message.pose.pose))
                covs.append(message.pose.covariance)
            else:
                rows.append(_numbers(message.pose if hasattr(message, "pose") else message.transform))
            child = child or frame_name(getattr(message, "child_frame_id", ""))
    where = f"{path} {name}"
    found = np.array(covs, dtype=np.float64).reshape(-1, 6, 6) if covs else None
    return PoseTopic(name, np.array(stamps, dtype=np.int64), _checked(where, rows), found, parent, child)


def read_transforms(path: Path, parent: str, child: str) -> list[tuple[NDArray[np.int64], Array]]:
    """Read the chain of transforms from `child` to `parent` in /tf and /tf_static, the link nearest `parent` first.

    Each link has stamps (N,), ns, and poses (N, 4, 4) of its frame in its parent; a static one has a single pose.
    Raises InputError, with the frames that there are, where no chain leads from one to the other.
    """
    tree, pair = TransformTree(), FramePair(frame_name(parent), frame_name(child))
    with opened(path) as reader:
        known = [c for c in reader.connections if c.msgtype in TRANSFORM_TYPES]
        for connection, record_ns, raw in reader.messages(known) if known else ():
            tree.take(str(path), connection.topic, reader.deserialize(raw, connection.msgtype), record_ns)
    try:
        links = [tree.transforms(link) for link in tree.chain(pair)]
    except ValueError as error:
        raise InputError(f"{path} /tf", str(error)) from None
    if all(len(link) == 1 for link in links):
        raise InputError(path, f"found {shown_name(child)} at rest in {shown_name(parent)}", "a moving frame")
    return [(np.array([ns for ns, _ in link], dtype=np.int64), np.array([T for _, T in link])) for link in links]


def _chosen(path: Path, reader: AnyReader, topic: str, kinds: Sequence[str], exclude: Collection[str]) -> str:
    """The topic that is wanted, or the only one of these types; InputError with the candidates otherwise."""
    types = {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}
    fitting = sorted(name for name, kind in types.items() if kind in kinds and name not in exclude)
    allowed = f"{', '.join(kind.rpartition('/')[2] for kind in kinds)}"
    if topic:
        if types.get(topic) not in kinds:
            raise wrong_topic(path, topic, types, f"no topic {topic!r}", fitting, allowed)
        return topic
    if not fitting:
        raise InputError(path, "found no topic of poses", allowed)
    return only_topic(path, fitting, "poses", "`topic`" if kinds is WITH_COVARIANCE else "`truth_topic`")


def wrong_topic(
    where: object, topic: str, types: Mapping[str, str], missing: str, fitting: Sequence[str], otherwise: str
) -> InputError:
    """The error of a topic that is not one of `fitting`; `missing` and `otherwise` where there is none."""
    found = f"{topic!r}, of type {shown_name(types[topic])}" if topic in types else missing
    allowed = ", ".join(map(shown_name, fitting)) if fitting else otherwise
    return InputError(where, f"found {found}", allowed, nearest(topic, fitting))


def only_topic(path: Path, names: Sequence[str], what: str, option: str) -> str:
    """The only topic of some; InputError that names the option where there are several."""
    if len(names) > 1:
        either = " or ".join(map(shown_name, names))
        raise InputError(path, f"found {len(names)} topics of {what}", f"one, by {option} {either}")
    return names[0]


def _numbers(pose: Any) -> list[float]:
    """The numbers x y z qx qy qz qw of a Pose or a Transform."""
    place = pose.position if hasattr(pose, "position") else pose.translation
    turn = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]


def _checked(where: str, rows: list[list[float]]) -> Array:
    poses = np.array(rows, dtype=np.float64).reshape(-1, 7)
    good = (np.abs(poses) <= LARGEST).all(axis=1) & np.any(poses[:, 3:], axis=1)
    if not good.all():
        row = int(np.argmin(good))
        found = tuple(poses[row].tolist())
        raise InputError(
            f"{where} message {row + 1}", f"found a pose of {found}", "finite numbers and a quaternion that is not zero"
        )
    return poses
