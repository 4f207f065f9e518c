"""Messages out and in again: poses, covariances, maps, frames, stamps, and how odometry and scans are joined."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from general import covariances, matrix, poses, some, stamps_ns, tilts, turned
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.live.publishing import PLAN, POSE, TF, publisher
from sixthsense.live.reading import TRANSFORMS, LaserReader, MessageReader, Notices
from sixthsense.live.robot import LiveRobot
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, stamp_ns
from sixthsense.logs.transforms import TransformTree
from sixthsense.record.messages import Messages

MAKE = Messages()
MS, HOUR = 1_000_000, 3_600_000_000_000
RANGES = np.array([2.5, 3.5, 0.7, 4.5, 6.5], dtype=np.float32)


def a_scan(increment_s: float = 0.0) -> Scan:
    return Scan(RANGES, np.float32(-0.7), np.float32(0.3), 9.0, time_increment=np.float32(increment_s))


def tilt(orientation: Any, quaternion: list[float]) -> None:
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion


@some
@given(stamps_ns, poses, tilts, st.floats(0.3, 3.0))
def test_odometry_comes_back_to_the_nanosecond_and_its_heading_is_that_of_a_tilted_quaternion(
    stamp, pose, tilted, size
):
    message = MAKE.odometry(stamp, pose)
    found = MessageReader().odometry(MAKE.serialized(message, ODOMETRY))
    assert (found.stamp_ns, found.frame, found.robot) == (stamp, "odom", "base_link")
    assert found.T_odom_robot.array() == pytest.approx(pose.array(), abs=1e-12)
    tilt(message.pose.pose.orientation, turned(pose.theta, tilted, size))
    found = MessageReader().odometry(MAKE.serialized(message, ODOMETRY))
    assert found.T_odom_robot.array() == pytest.approx(pose.array(), abs=1e-9)


@some
@given(poses, poses, tilts, st.booleans())
def test_a_mount_is_the_product_of_tilted_static_transforms(plate, mount, tilted, is_upside_down):
    level = turned(mount.theta, (0.0, math.pi if is_upside_down else 0.0))
    T_robot_plate = matrix(plate.x, plate.y, 0.4, turned(plate.theta, tilted))
    T_plate_laser = np.linalg.inv(T_robot_plate) @ matrix(mount.x, mount.y, 0.7, level)
    reader, tree = MessageReader(), TransformTree()
    for parent, child, T in (("base", "plate", T_robot_plate), ("plate", "laser", T_plate_laser)):
        message = MAKE.transform(7, parent, child, Pose(*T[:2, 3]))
        message.transforms[0].transform.translation.z = float(T[2, 3])
        tilt(message.transforms[0].transform.rotation, Rotation.from_matrix(T[:3, :3]).as_quat().tolist())
        reader.add_transforms(MAKE.serialized(message, TRANSFORMS), tree)
    place, upside_down = tree.mount("base", "laser")
    assert upside_down == is_upside_down and place.array() == pytest.approx(mount.array(), abs=1e-9)
    laser = LaserReader(reader, None, place)
    laser.upside_down = upside_down
    stamp, found = laser.scan(MAKE.serialized(MAKE.scan(1_700_000_000_123_456_789, a_scan()), LASER_SCAN))
    assert stamp == 1_700_000_000_123_456_789
    side = -1.0 if is_upside_down else 1.0
    bearings = -0.7 + 0.3 * np.arange(5)
    points_laser = RANGES[:, None] * np.stack([np.cos(bearings), side * np.sin(bearings)], axis=1)
    points = found.points_robot[::-1] if is_upside_down else found.points_robot
    np.testing.assert_allclose(points, mount @ points_laser, atol=1e-5)


class Sink:
    """A node that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {topic.name: [] for topic in (POSE, TF, PLAN)}

    def writer(self, topic: Any) -> Any:
        keep = self.sent[topic.name].append
        return SimpleNamespace(send=lambda data: keep(MAKE.store.deserialize_cdr(data, topic.type)))


def robot_with(T_joined_odom: Pose) -> LiveRobot:
    robot = LiveRobot(lambda _: (), Notices(print), preset("log"))
    robot.joiner.T_joined_odom, robot.odom_frame = T_joined_odom, "wheels"
    return robot


def a_trace(estimate: Pose, key: Pose, key_cov: np.ndarray, since: Pose, since_cov: np.ndarray) -> Any:
    return SimpleNamespace(
        estimates=[(7.0, 8.0, 2.0), estimate.array()],
        key_estimates=[None, SimpleNamespace(pose=key, pose_cov=key_cov)],
        since_key=[(7.0, 8.0, 2.0), since.array()],
        live=SimpleNamespace(since_cov=since_cov),
        plans=[],
    )


@some
@given(poses, poses, covariances, poses, covariances, poses)
def test_what_is_published_is_the_pose_its_covariance_and_the_frame_of_odometry(
    T_joined_odom, key, key_cov, since, since_cov, odometry
):
    robot, sink, estimate = robot_with(T_joined_odom), Sink(), key @ since
    trace, time_ns = a_trace(estimate, key, key_cov, since, since_cov), 2 * HOUR + 123_456_789
    publish = publisher(sink.writer, robot)
    publish(Tick(time_ns, odometry), trace)
    assert not any(sink.sent.values())
    publish(Tick(time_ns, odometry, a_scan()), trace)
    trace.plans.append(np.array([[1.5, 2.5], [3.5, -0.5], [4.5, 0.7]]))
    for _ in range(2):
        publish(Tick(time_ns + 1, odometry), trace)
    (plan,) = sink.sent["/plan"]
    found = [(at.pose.position.x, at.pose.position.y) for at in plan.poses]
    assert found == [(1.5, 2.5), (3.5, -0.5), (4.5, 0.7)] and plan.header.frame_id == "map"
    (pose,), ((link,),) = sink.sent["/pose"], (message.transforms for message in sink.sent["/tf"])
    assert (stamp_ns(pose), stamp_ns(link)) == (time_ns, time_ns + 200 * MS)
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (estimate.x, estimate.y)
    heading = 2.0 * math.atan2(pose.pose.pose.orientation.z, pose.pose.pose.orientation.w)
    assert wrap_angle(heading - estimate.theta) == pytest.approx(0.0, abs=1e-12)
    # Against adjoints: the error in the axes of the keyframe, brought to those of the robot and of the world.
    cov, moved = pose.pose.covariance.reshape(6, 6), since.inverse().adjoint()
    in_key = Pose(theta=key.theta).adjoint().T @ key_cov @ Pose(theta=key.theta).adjoint()
    in_robot = moved @ in_key @ moved.T + since_cov
    to_world = Pose(theta=estimate.theta).adjoint()
    plane = np.ix_((0, 1, 5), (0, 1, 5))
    np.testing.assert_allclose(cov[plane], to_world @ in_robot @ to_world.T, rtol=1e-9, atol=1e-9)
    assert np.count_nonzero(cov) == 9
    # The robot's own message of odometry, in the frame that is published.
    T_map_odom = Pose(link.transform.translation.x, link.transform.translation.y,
                      2.0 * math.atan2(link.transform.rotation.z, link.transform.rotation.w))  # fmt: skip
    assert (link.header.frame_id, link.child_frame_id) == ("map", "wheels")
    at = T_map_odom @ (T_joined_odom.inverse() @ odometry)
    assert at.position == pytest.approx(estimate.position, abs=1e-9)
    assert wrap_angle(at.theta - estimate.theta) == pytest.approx(0.0, abs=1e-9)
