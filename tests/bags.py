"""Bags as the library of ROS writes them: the messages of somebody else's robot, in ROS 1 or ROS 2."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sixthsense.core.geometry import Pose

KINDS = ["ros1", "mcap", "sqlite"]
_TF = "geometry_msgs/TransformStamped[] transforms"


class Bag:
    """Types of messages are named without `msg`; a message is recorded at its stamp unless `record_ns` is given."""

    def __init__(self, path: Path, kind: str = "mcap") -> None:
        one = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
        if one:  # it does not know tf2
            self.store.register(get_types_from_msg(_TF, "tf2_msgs/msg/TFMessage"))
        self.path = path.with_suffix(".bag") if one else path
        plugin = StoragePlugin.SQLITE3 if kind == "sqlite" else StoragePlugin.MCAP
        self.writer = Writer1(self.path) if one else Writer2(path, version=9, storage_plugin=plugin)
        self.serialized = self.store.serialize_ros1 if one else self.store.serialize_cdr
        self.sequence, self.topics = (0,) if one else (), {}

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, name: str, *values: Any) -> Any:
        return self.store.types[name.replace("/", "/msg/")](*values)

    def put(self, topic: str, name: str, record_ns: int, *values: Any) -> None:
        kind = name.replace("/", "/msg/")
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        self.writer.write(self.topics[topic], record_ns, self.serialized(self.make(name, *values), kind))

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/Time", *divmod(stamp_ns, 10**9))
        return self.make("std_msgs/Header", *self.sequence, stamp, frame)

    def turned(self, pose: Pose, turn: tuple[float, ...] | None) -> Any:
        half = 0.5 * pose.theta
        return self.make("geometry_msgs/Quaternion", *(turn or (0.0, 0.0, math.sin(half), math.cos(half))))

    def pose(self, pose: Pose, turn: tuple[float, ...] | None = None) -> Any:
        place = self.make("geometry_msgs/Point", pose.x, pose.y, 0.0)
        return self.make("geometry_msgs/Pose", place, self.turned(pose, turn))

    def spread(self, pose: Pose, turn: tuple[float, ...] | None = None, cov: Any = None) -> Any:
        cov = np.zeros(36) if cov is None else cov
        return self.make("geometry_msgs/PoseWithCovariance", self.pose(pose, turn), cov)

    def odometry(
        self, stamp_ns, pose, topic="/odom", *, turn=None, frame="odom", child="base_footprint",
        record_ns=None, cov=None,
    ) -> None:  # fmt: skip
        zero = self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/Twist", zero, zero)
        twist = self.make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36))
        values = self.header(stamp_ns, frame), child, self.spread(pose, turn, cov), twist
        self.put(topic, "nav_msgs/Odometry", stamp_ns if record_ns is None else record_ns, *values)

    def scan(
        self, stamp_ns, ranges, topic="/scan", *, first=-2.0, step=0.017, low=0.1, high=8.0,
        frame="laser", lag=0.0, echo=False, record_ns=None, last=None,
    ) -> None:  # fmt: skip
        row, echoes = np.asarray(ranges, dtype=np.float32), [] if echo else np.empty(0, np.float32)
        last, beams = first + step * (len(row) - 1) if last is None else last, row
        if echo:
            beams = [self.make("sensor_msgs/LaserEcho", row[i : i + 1]) for i in range(len(row))]
        values = self.header(stamp_ns, frame), first, last, step, lag, 0.1, low, high, beams, echoes
        name = "sensor_msgs/MultiEchoLaserScan" if echo else "sensor_msgs/LaserScan"
        self.put(topic, name, stamp_ns if record_ns is None else record_ns, *values)

    def transform(self, parent, child, place, turn=None, up=0.0, stamp_ns=None, record_ns=0) -> None:
        """A static transform, or with a stamp one of /tf."""
        shift = self.make("geometry_msgs/Vector3", place.x, place.y, up)
        link = self.make("geometry_msgs/Transform", shift, self.turned(place, turn))
        stamped = self.make("geometry_msgs/TransformStamped", self.header(stamp_ns or 0, parent), child, link)
        self.put("/tf_static" if stamp_ns is None else "/tf", "tf2_msgs/TFMessage", stamp_ns or record_ns, [stamped])
