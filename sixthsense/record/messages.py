"""ROS 2 messages of poses, scans and estimates, and their serialized form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.logs.ros_messages import spatial_covariance

WORLD, ODOM, ROBOT, LASER = "map", "odom", "base_link", "laser"
"""names of the frames"""
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


_LAST_STAMP_NS = (1 << 31) * 1_000_000_000 - 1  # ROS counts seconds in 32 bits


class Messages:
    """Makes messages of ROS 2 Humble. Stamps are nanoseconds."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        """definitions of all types"""
        self._types = self.store.types

    def serialized(self, message: Any, name: str) -> bytes:
        """A message of the type of this name as little-endian CDR."""
        return bytes(self.store.serialize_cdr(message, name))

    def header(self, stamp_ns: int, frame: str) -> Any:
        """std_msgs/Header."""
        time = divmod(min(stamp_ns, _LAST_STAMP_NS), 1_000_000_000)
        return self._types["std_msgs/msg/Header"](self._types["builtin_interfaces/msg/Time"](*time), frame)

    def pose(self, pose: Pose) -> Any:
        """geometry_msgs/Pose."""
        z, w = quaternion(pose.theta)
        return self._types["geometry_msgs/msg/Pose"](
            self._types["geometry_msgs/msg/Point"](pose.x, pose.y, 0.0),
            self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, z, w),
        )

    def pose_stamped(self, stamp_ns: int, pose: Pose) -> Any:
        """geometry_msgs/PoseStamped in the world frame."""
        return self._types["geometry_msgs/msg/PoseStamped"](self.header(stamp_ns, WORLD), self.pose(pose))

    def path(self, stamp_ns: int, path_world: Array) -> Any:
        """nav_msgs/Path of (N, 2) points."""
        poses = [self.pose_stamped(stamp_ns, Pose(x, y)) for x, y in path_world.tolist()]
        return self._types["nav_msgs/msg/Path"](self.header(stamp_ns, WORLD), poses)

    def odometry(self, stamp_ns: int, pose: Pose) -> Any:
        """nav_msgs/Odometry; its covariances are zero, which says that they are not known."""
        pose_with_cov = self._types["geometry_msgs/msg/PoseWithCovariance"]
        return self._types["nav_msgs/msg/Odometry"](
            self.header(stamp_ns, ODOM),
            ROBOT,
            pose_with_cov(self.pose(pose), np.zeros(36)),
            self._types["geometry_msgs/msg/TwistWithCovariance"](self.twist(0.0, 0.0), np.zeros(36)),
        )

    def status(self, level: int, name: str, message: str, hardware: str, values: Mapping[str, str]) -> Any:
        """diagnostic_msgs/DiagnosticStatus; levels are 0 OK, 1 WARN, 2 ERROR."""
        pair = self._types["diagnostic_msgs/msg/KeyValue"]
        pairs = [pair(key, value) for key, value in values.items()]
        return self._types["diagnostic_msgs/msg/DiagnosticStatus"](level, name, message, hardware, pairs)

    def diagnostics(self, stamp_ns: int, statuses: Sequence[Any]) -> Any:
        """diagnostic_msgs/DiagnosticArray."""
        return self._types[DIAGNOSTICS](self.header(stamp_ns, ""), [*statuses])

    def twist(self, speed: float, turn_rate: float) -> Any:
        """geometry_msgs/Twist of a robot on a floor, m/s and rad/s."""
        vector = self._types["geometry_msgs/msg/Vector3"]
        return self._types["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn_rate))

    def twist_stamped(self, stamp_ns: int, frame: str, speed: float, turn_rate: float) -> Any:
        """geometry_msgs/TwistStamped in the frame of the robot, m/s and rad/s."""
        twist = self.twist(speed, turn_rate)
        return self._types["geometry_msgs/msg/TwistStamped"](self.header(stamp_ns, frame), twist)

    def scan(self, stamp_ns: int, scan: Scan) -> Any:
        """sensor_msgs/LaserScan; the stamp is that of the first beam."""
        first, step = scan.angle_min, scan.angle_increment
        last = np.float32(first + step * (len(scan.ranges) - 1))
        intensities = np.zeros(0, dtype=np.float32)
        return self._types["sensor_msgs/msg/LaserScan"](
            self.header(stamp_ns, LASER), first, last, step, scan.time_increment, 0, 0,
            scan.max_range, scan.ranges, intensities,
        )  # fmt: skip

    def estimate(self, stamp_ns: int, pose: Pose, cov: Array) -> Any:
        """geometry_msgs/PoseWithCovarianceStamped in the world frame, of (3, 3) covariance."""
        pose_with_cov = self._types["geometry_msgs/msg/PoseWithCovariance"](
            self.pose(pose), spatial_covariance(cov).ravel()
        )
        return self._types["geometry_msgs/msg/PoseWithCovarianceStamped"](self.header(stamp_ns, WORLD), pose_with_cov)

    def transform(self, stamp_ns: int, parent: str, child: str, T_parent_child: Pose) -> Any:
        """tf2_msgs/TFMessage of one transform."""
        z, w = quaternion(T_parent_child.theta)
        transform = self._types["geometry_msgs/msg/Transform"](
            self._types["geometry_msgs/msg/Vector3"](T_parent_child.x, T_parent_child.y, 0.0),
            self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, z, w),
        )
        stamped = self._types["geometry_msgs/msg/TransformStamped"](self.header(stamp_ns, parent), child, transform)
        return self._types["tf2_msgs/msg/TFMessage"]([stamped])

    def occupancy(self, stamp_ns: int, occupancy: NDArray[np.int8], origin: tuple[float, float], cell_m: float) -> Any:
        """nav_msgs/OccupancyGrid of (H, W) cells: -1 unknown, 0 free, 100 occupied; `origin` is the lower left."""
        height, width = occupancy.shape
        header = self.header(stamp_ns, WORLD)
        info = self._types["nav_msgs/msg/MapMetaData"](header.stamp, cell_m, width, height, self.pose(Pose(*origin)))
        return self._types["nav_msgs/msg/OccupancyGrid"](header, info, occupancy.ravel())


def quaternion(theta: float) -> tuple[float, float]:
    """Z and w of a rotation by `theta` about z."""
    return math.sin(0.5 * theta), math.cos(0.5 * theta)
