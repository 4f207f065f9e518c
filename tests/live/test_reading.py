"""Messages from the network: what is read, and what is not."""

import math
from typing import Any

import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.live.reading import TRANSFORMS, TWIST, LaserReader, MessageReader
from sixthsense.record.messages import Messages
from sixthsense.sources.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.sources.logs.transforms import FramePair, TransformTree

MAKE = Messages()
STAMP = 1_700_000_000_123_456_789


def scan_of(beams: int = 360, max_range: float = 10.0) -> Scan:
    step = np.float32(2.0 * math.pi / beams)
    ranges = np.linspace(1.0, 2.0, beams, dtype=np.float32)
    return Scan(ranges, np.float32(-math.pi), step, max_range)


def scan_message(beams: int = 360, **changes: Any) -> bytes:
    message = MAKE.scan(STAMP, scan_of(beams))
    for name, value in changes.items():
        setattr(message, name, value)
    return MAKE.serialized(message, LASER_SCAN)


def laser(max_range: float | None = None) -> LaserReader:
    return LaserReader(MessageReader(), max_range, Pose(0.1, 0.0, 0.0))


def odometry_message(**changes: Any) -> bytes:
    message = MAKE.odometry(STAMP, Pose(1.0, 2.0, 0.5), None)
    for name, value in changes.items():
        setattr(message, name, value)
    return MAKE.serialized(message, ODOMETRY)


def test_a_scan_is_read_with_its_stamp_and_the_mount():
    stamp_ns, scan = laser().scan(scan_message())
    assert stamp_ns == STAMP and scan.T_robot_laser == Pose(0.1, 0.0, 0.0)
    np.testing.assert_array_equal(scan.ranges, scan_of().ranges)


def test_odometry_is_read_with_its_frames():
    found = MessageReader().odometry(odometry_message())
    assert (found.stamp_ns, found.frame, found.robot) == (STAMP, "odom", "base_link")
    np.testing.assert_allclose(found.T_odom_robot.array(), [1.0, 2.0, 0.5])


def test_odometry_is_read_from_the_transform_between_two_frames_and_other_transforms_are_none():
    reader = MessageReader(FramePair("odom", "base_link"))
    own, other = (
        MAKE.serialized(MAKE.transform(STAMP, parent, "base_link", Pose(1.0, 2.0, 0.5)), TRANSFORMS)
        for parent in ("odom", "map")
    )
    assert reader.has_odometry(own) and not reader.has_odometry(other)
    assert reader.has_odometry(b"damaged")  # which is named when it is read
    found = reader.odometry(own)
    assert (found.stamp_ns, found.frame, found.robot) == (STAMP, "odom", "base_link")
    np.testing.assert_allclose(found.T_odom_robot.array(), [1.0, 2.0, 0.5])
    with pytest.raises(ValueError, match=r"found no transform odom -> base_link, allowed: one"):
        reader.odometry(other)


@pytest.mark.parametrize(
    "changes",
    [
        {"angle_min": math.nan},
        {"angle_increment": 0.0},
        {"angle_increment": math.inf},
        {"ranges": np.zeros(0, np.float32)},
        {"ranges": np.zeros(1, np.float32)},
        {"ranges": np.zeros(100_001, np.float32), "angle_increment": 1e-5},
        {"header": MAKE.header(0, "laser")},
        {"header": MAKE.header(STAMP, "x" * 257)},
    ],
)
def test_a_scan_with_numbers_that_are_not_allowed_is_named(changes):
    with pytest.raises(ValueError, match=r"found .*, allowed: "):
        laser().scan(scan_message(**changes))


@pytest.mark.parametrize("name", [LASER_SCAN, ODOMETRY, TRANSFORMS, TWIST])
@pytest.mark.parametrize("seed", range(5))
def test_damaged_bytes_are_a_value_error(name, seed):
    whole = {
        LASER_SCAN: scan_message(),
        ODOMETRY: odometry_message(),
        TRANSFORMS: MAKE.serialized(MAKE.transform(STAMP, "a", "b", Pose()), TRANSFORMS),
        TWIST: MAKE.serialized(MAKE.twist(1.0, 2.0), TWIST),
    }[name]
    rng = np.random.default_rng(seed)
    reader, tree = MessageReader(), TransformTree()
    read = {
        LASER_SCAN: laser().scan,
        ODOMETRY: reader.odometry,
        TRANSFORMS: lambda data: reader.add_static(data, tree),
        TWIST: reader.command,
    }[name]
    for _ in range(50):
        data = bytearray(whole[: rng.integers(0, len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(0, 6)):
            if data:
                data[rng.integers(0, min(len(data), 120))] = rng.integers(0, 256)
        try:
            read(bytes(data))
        except ValueError as error:
            assert "\n" not in str(error)


def test_the_mount_follows_the_chain_of_static_transforms():
    reader, frames = MessageReader(), TransformTree()
    assert frames.mount("base_link", "laser") is None
    for parent, child, pose in (("base_link", "plate", Pose(0.1, 0.0, 0.0)), ("plate", "laser", Pose(0.0, 0.2, 1.0))):
        reader.add_static(MAKE.serialized(MAKE.transform(STAMP, parent, child, pose), TRANSFORMS), frames)
    found = frames.mount("base_link", "laser")
    assert found is not None and not found[1]
    np.testing.assert_allclose(found[0].array(), [0.1, 0.2, 1.0])
