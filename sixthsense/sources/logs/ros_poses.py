"""Poses in ROS 1 and ROS 2 bags: of a topic, with their covariances, or of a pair of frames in /tf."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.section import shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.core.geometry import Array
from sixthsense.sources.logs.bag_file import checked_stamp, opened
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.ros_messages import ODOMETRY, frame_name, stamp_ns
from sixthsense.sources.logs.text_lines import LARGEST
from sixthsense.sources.logs.transforms import TRANSFORM_TYPES, FramePair, TransformTree

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


def read_poses(path: Path, topic: str = "", with_covariance: bool = True, besides: Collection[str] = ()) -> PoseTopic:
    """Read the poses of a topic, by default of the only one with poses, `besides` excepted.

    Raises LogError with the candidates unless there is one, and for a bag or a pose that cannot be read.
    """
    kinds = WITH_COVARIANCE if with_covariance else (*WITH_COVARIANCE, *WITHOUT)
    rows: list[list[float]] = []
    covs: list[Any] = []
    stamps: list[int] = []
    parent = child = ""
    with opened(path) as reader:
        name = _chosen(path, reader, topic, kinds, besides)
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
    Raises LogError, with the frames that there are, where no chain leads from one to the other.
    """
    tree, pair = TransformTree(), FramePair(frame_name(parent), frame_name(child))
    with opened(path) as reader:
        known = [c for c in reader.connections if c.msgtype in TRANSFORM_TYPES]
        for connection, record_ns, raw in reader.messages(known) if known else ():
            tree.take(str(path), connection.topic, reader.deserialize(raw, connection.msgtype), record_ns)
    try:
        links = [tree.transforms(link) for link in tree.chain(pair)]
    except ValueError as error:
        raise LogError(f"{path} /tf: {error}") from None
    if all(len(link) == 1 for link in links):
        raise LogError(f"{path}: found {shown_name(child)} at rest in {shown_name(parent)}, allowed: a moving frame")
    return [(np.array([ns for ns, _ in link], dtype=np.int64), np.array([T for _, T in link])) for link in links]


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
