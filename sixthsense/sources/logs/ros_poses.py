"""Poses in ROS 1 and ROS 2 bags: of a topic, with their covariances, or of a pair of frames in /tf."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.section import shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.core.geometry import Array
from sixthsense.sources.logs.bag_recording import LARGEST_STAMP_NS, TRANSFORM_TYPES, as_log_error, check_first_line
from sixthsense.sources.logs.decompress import bounded, check_regular
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.ros_frames import frame_name
from sixthsense.sources.logs.ros_messages import ODOMETRY, stamp_ns
from sixthsense.sources.logs.text_lines import LARGEST

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

WITH_COVARIANCE = ("geometry_msgs/msg/PoseWithCovarianceStamped", ODOMETRY)
WITHOUT = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")


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


@dataclass(slots=True)
class _Link:
    """The transforms from a frame to its parent."""

    parent: str
    is_static: bool
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)


def read_poses(path: Path, topic: str = "", with_covariance: bool = True, besides: Collection[str] = ()) -> PoseTopic:
    """Read the poses of a topic, by default of the only one with poses, `besides` excepted.

    Raises LogError with the candidates unless there is one, and for a bag or a pose that cannot be read.
    """
    kinds = WITH_COVARIANCE if with_covariance else (*WITH_COVARIANCE, *WITHOUT)
    rows: list[list[float]] = []
    covs: list[Any] = []
    stamps: list[int] = []
    parent = child = ""
    with _opened(path) as reader:
        name = _chosen(path, reader, topic, kinds, besides)
        for connection, record_ns, raw in reader.messages([c for c in reader.connections if c.topic == name]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamps.append(stamp_ns(message) or record_ns)
            parent = parent or frame_name(message.header.frame_id)
            if connection.msgtype in WITH_COVARIANCE:
                rows.append(_numbers(message.pose.pose))
                covs.append(message.pose.covariance)
            else:
                rows.append(_numbers(message.pose if hasattr(message, "pose") else message.transform))
            child = child or frame_name(getattr(message, "child_frame_id", ""))
    where = f"{path} {name}"
    found = np.array(covs, dtype=np.float64).reshape(-1, 6, 6) if covs else None
    return PoseTopic(name, _checked_stamps(where, stamps), _checked(where, rows), found, parent, child)


def read_transforms(path: Path, parent: str, child: str) -> list[tuple[NDArray[np.int64], Array]]:
    """Read the chain of transforms from `child` to `parent` in /tf and /tf_static, the link nearest `parent` first.

    Each link has stamps (N,), ns, and poses (N, 7) of its frame in its parent; a static one has a single pose. Raises
    LogError, with the frames that there are, where no chain leads from one to the other.
    """
    links: dict[str, _Link] = {}
    with _opened(path) as reader:
        known = [c for c in reader.connections if c.msgtype in TRANSFORM_TYPES]
        for connection, record_ns, raw in reader.messages(known) if known else ():
            message: Any = reader.deserialize(raw, connection.msgtype)
            is_static = connection.topic.endswith("tf_static")
            for one in message.transforms:
                link = links.setdefault(
                    frame_name(one.child_frame_id), _Link(frame_name(one.header.frame_id), is_static)
                )
                link.stamps_ns.append(stamp_ns(one) or record_ns)
                link.poses.append(_numbers(one.transform))
    chain: list[_Link] = []
    frame = frame_name(child)
    while frame != frame_name(parent):
        if frame not in links or len(chain) > len(links):
            pairs = ", ".join(f"{shown_name(link.parent)} {shown_name(name)}" for name, link in sorted(links.items()))
            raise LogError(
                f"{path}: found no transforms from {shown_name(child)} to {shown_name(parent)}, "
                f"allowed: frames of /tf, parent and child {pairs or '(there is none)'}"
            )
        chain.insert(0, links[frame])
        frame = links[frame].parent
    if not chain or all(link.is_static for link in chain):
        raise LogError(f"{path}: found {shown_name(child)} at rest in {shown_name(parent)}, allowed: a moving frame")
    found = []
    for link in chain:
        rows = slice(-1, None) if link.is_static else slice(None)
        where = f"{path} /tf"
        found.append((_checked_stamps(where, link.stamps_ns[rows]), _checked(where, link.poses[rows])))
    return found


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise LogError(f"{path}: no such file")
    with as_log_error(path):
        check_regular(path)
        check_first_line(path)
        with bounded(path), AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader


def _chosen(path: Path, reader: AnyReader, topic: str, kinds: Sequence[str], besides: Collection[str]) -> str:
    """The topic that is wanted, or the only one of these types; LogError with the candidates otherwise."""
    types = {c.topic: c.msgtype for c in reader.connections if reader.topics[c.topic].msgcount}
    fitting = sorted(name for name, kind in types.items() if kind in kinds and name not in besides)
    if topic:
        if types.get(topic) not in kinds:
            found = f"{topic!r}, of type {shown_name(types[topic])}" if topic in types else f"no topic {topic!r}"
            offered = allowed_names(map(shown_name, fitting), nearest(topic, fitting)) if fitting else _kinds(kinds)
            raise LogError(f"{path}: found {found}, {offered}")
        return topic
    if not fitting:
        raise LogError(f"{path}: found no topic of poses, {_kinds(kinds)}")
    if len(fitting) > 1:
        option = "--topic" if kinds is WITH_COVARIANCE else "--truth-topic"
        raise LogError(
            f"{path}: found {len(fitting)} topics of poses, allowed: one, by {option} "
            f"{' or '.join(map(shown_name, fitting))}"
        )
    return fitting[0]


def _kinds(kinds: Sequence[str]) -> str:
    return f"allowed: {', '.join(kind.rpartition('/')[2] for kind in kinds)}"


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
        raise LogError(
            f"{where} message {row + 1}: found a pose of {found}, allowed: finite numbers and a quaternion that is not "
            "zero"
        )
    return poses


def _checked_stamps(where: str, stamps: list[int]) -> NDArray[np.int64]:
    bad = next((stamp for stamp in stamps if not 0 <= stamp <= LARGEST_STAMP_NS), None)
    if bad is not None:
        raise LogError(f"{where}: found stamp {bad} ns, allowed: 0 to {LARGEST_STAMP_NS} ns")
    return np.array(stamps, dtype=np.int64)
