"""Messages from the network: what is read, and what is not."""

import math
from typing import Any

import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.live.reading import TRANSFORMS, TWIST, FrameReader, LaserReader, MessageReader
from sixthsense.record.messages import Messages
from sixthsense.sources.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.sources.logs.tf_odometry import FramePair

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


@pytest.mark.parametrize("value", [math.inf, math.nan, -1.0, 5000.0])
def test_a_range_max_that_no_laser_has_is_named_unless_it_is_stated(value):
    with pytest.raises(ValueError, match=r"found range_max .*, allowed: .*--laser\.max-range"):
        laser().scan(scan_message(range_max=value))
    if value > 0.0:
        assert laser(max_range=12.0).scan(scan_message(range_max=value))[1].max_range == 12.0


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


def test_a_stamp_whose_nanoseconds_are_a_second_or_more_is_named():
    header = MAKE.header(STAMP, "laser")
    header.stamp.nanosec = 2_000_000_000
    with pytest.raises(ValueError, match="found the stamp"):
        laser().scan(scan_message(header=header))


def test_ranges_that_are_no_numbers_are_no_returns():
    ranges = np.array([1.0, np.nan, np.inf, -1.0, 11.0] * 72, dtype=np.float32)
    _, scan = laser().scan(scan_message(ranges=ranges))
    assert np.isfinite(scan.ranges).sum() == 72


def test_beams_of_another_geometry_in_mid_stream_are_named_and_those_of_the_first_go_on():
    reader = laser()
    reader.scan(scan_message())
    for beams in (180, 720):
        with pytest.raises(ValueError, match=f"found a laser of {beams} beams .*, allowed: as in the first scan, 360"):
            reader.scan(scan_message(beams))
    with pytest.raises(ValueError, match="as in the first scan"):
        reader.scan(scan_message(range_max=8.0))
    with pytest.raises(ValueError, match="found a scan of rear, allowed: of laser"):
        reader.scan(scan_message(header=MAKE.header(STAMP, "rear")))
    assert reader.scan(scan_message())[0] == STAMP


def test_a_few_beams_more_or_less_are_those_of_the_same_laser():
    reader = laser()
    assert [len(reader.scan(scan_message(beams))[1].ranges) for beams in (360, 358, 363)] == [360, 358, 363]


def test_a_message_that_is_too_long_is_not_read():
    reader = MessageReader()
    for name in (LASER_SCAN, ODOMETRY, TRANSFORMS, TWIST):
        with pytest.raises(ValueError, match="found a message of 10000000 bytes"):
            reader.read(bytes(10_000_000), name)


@pytest.mark.parametrize("name", [LASER_SCAN, ODOMETRY, TRANSFORMS, TWIST])
@pytest.mark.parametrize("seed", range(20))
def test_damaged_bytes_are_a_value_error(name, seed):
    whole = {
        LASER_SCAN: scan_message(),
        ODOMETRY: odometry_message(),
        TRANSFORMS: MAKE.serialized(MAKE.transform(STAMP, "a", "b", Pose()), TRANSFORMS),
        TWIST: MAKE.serialized(MAKE.twist(1.0, 2.0), TWIST),
    }[name]
    rng = np.random.default_rng(seed)
    reader, frames = MessageReader(), FrameReader(MessageReader())
    read = {LASER_SCAN: laser().scan, ODOMETRY: reader.odometry, TRANSFORMS: frames.add, TWIST: reader.command}[name]
    for _ in range(50):
        data = bytearray(whole[: rng.integers(0, len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(0, 6)):
            if data:
                data[rng.integers(0, min(len(data), 120))] = rng.integers(0, 256)
        try:
            read(bytes(data))
        except ValueError as error:
            assert "\n" not in str(error)


def test_a_string_that_claims_to_be_endless_takes_no_memory():
    data = bytearray(scan_message())
    data[12:16] = (0xFFFFFFF0).to_bytes(4, "little")  # the length of the frame's name
    with pytest.raises(ValueError, match=r"cannot be read|letters"):
        laser().scan(bytes(data))


def test_a_command_is_read_and_one_that_no_robot_can_follow_is_not():
    reader = MessageReader()
    assert reader.command(MAKE.serialized(MAKE.twist(0.3, -0.2), TWIST)) == Command(0.3, -0.2)
    for speed in (math.nan, math.inf, 1e6):
        with pytest.raises(ValueError, match="found a command"):
            reader.command(MAKE.serialized(MAKE.twist(speed, 0.0), TWIST))


def test_the_mount_follows_the_chain_of_static_transforms():
    frames = FrameReader(MessageReader())
    assert frames.mount("base_link", "laser") is None
    for parent, child, pose in (("base_link", "plate", Pose(0.1, 0.0, 0.0)), ("plate", "laser", Pose(0.0, 0.2, 1.0))):
        frames.add(MAKE.serialized(MAKE.transform(STAMP, parent, child, pose), TRANSFORMS))
    found = frames.mount("base_link", "laser")
    assert found is not None and not found[1]
    np.testing.assert_allclose(found[0].array(), [0.1, 0.2, 1.0])


def test_a_laser_in_the_robots_own_frame_needs_no_transform():
    assert FrameReader(MessageReader()).mount("base_scan", "base_scan") == (Pose(), False)


def test_frames_in_a_circle_are_named():
    frames = FrameReader(MessageReader())
    for parent, child in (("a", "b"), ("b", "a")):
        frames.add(MAKE.serialized(MAKE.transform(STAMP, parent, child, Pose()), TRANSFORMS))
    with pytest.raises(ValueError, match="circle"):
        frames.mount("base_link", "a")
