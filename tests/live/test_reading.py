"""Messages from the network: what is read, and what is not."""

import math
from typing import Any

import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.live.reading import POSE, TRANSFORMS, TWIST, TWIST_STAMPED, LaserReader, MessageReader, Notices
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, TransformTree
from sixthsense.record.messages import Messages

MAKE = Messages()
STAMP = 1_700_000_000_123_456_789


def ill_stamped() -> Any:
    header = MAKE.header(STAMP, "laser")
    header.stamp.nanosec = 1_000_000_000
    return header


def scan_message(beams: int = 360, **changes: Any) -> bytes:
    ranges = np.linspace(1.0, 2.0, beams, dtype=np.float32)
    message = MAKE.scan(STAMP, Scan(ranges, np.float32(-math.pi), np.float32(2.0 * math.pi / beams), 10.0))
    for name, value in changes.items():
        setattr(message, name, value)
    return MAKE.serialized(message, LASER_SCAN)


def laser(max_range: float | None = None) -> LaserReader:
    return LaserReader(MessageReader(), max_range, Pose(0.2, -0.3, 0.4))


ODOMETRY_MESSAGE = MAKE.serialized(MAKE.odometry(STAMP, Pose(1.0, 2.0, 0.5)), ODOMETRY)


@pytest.mark.parametrize("name", [TWIST, TWIST_STAMPED])
def test_a_command_is_speed_ahead_and_turn_rate_about_the_vertical_each_up_to_a_bound(name):
    def read(speed: float, turn_rate: float) -> Command:
        message = MAKE.twist(speed, turn_rate) if name == TWIST else MAKE.twist_stamped(STAMP, "base", speed, turn_rate)
        return MessageReader().command(MAKE.serialized(message, name), name)

    assert read(0.37, -0.62) == Command(0.37, -0.62) and read(-99.5, 99.5) == Command(-99.5, 99.5)
    for given in ((100.5, 0.3), (-100.5, 0.3), (0.3, 100.5), (0.3, -100.5), (math.nan, 0.3), (0.3, math.nan)):
        with pytest.raises(ValueError, match=r"found a command of .*, allowed: up to 100"):
            read(*given)


def test_a_message_that_is_too_large_is_not_read_and_a_tree_takes_a_thousand_frames():
    with pytest.raises(ValueError, match="found a message of 1048577 bytes, allowed: 1048576"):
        MessageReader().odometry(ODOMETRY_MESSAGE.ljust(1048577, b"\0"))
    tree, reader = TransformTree(), MessageReader()
    links = [MAKE.transform(STAMP, "base_link", f"laser{k}", Pose(0.2)).transforms[0] for k in range(1005)]
    reader.add_transforms(MAKE.serialized(MAKE.store.types[TRANSFORMS](links), TRANSFORMS), tree)
    assert len(tree.links) == 1000


def test_each_scan_has_its_own_beams_and_range_or_the_range_that_was_stated():
    _, first = laser(1.7).scan(scan_message(range_max=2000.0))
    assert first.max_range == 1.7 and first.T_robot_laser == Pose(0.2, -0.3, 0.4)
    expected = np.linspace(1.0, 2.0, 360, dtype=np.float32)
    np.testing.assert_array_equal(first.ranges, np.where(expected <= np.float32(1.7), expected, np.inf))
    found = laser()
    assert [found.scan(scan_message(range_max=m))[1].max_range for m in (10.0, 9.0)] == [10.0, 9.0]
    _, fewer = found.scan(scan_message(300, angle_increment=0.012, angle_min=-1.7))
    assert len(fewer.ranges) == 300 and fewer.bearings[2] == pytest.approx(-1.7 + 0.024, abs=1e-6)


def test_the_laser_is_that_of_the_first_scan():
    found, other = laser(), scan_message(header=MAKE.header(STAMP, "back"))
    found.scan(other)
    with pytest.raises(ValueError, match="found a scan of laser, allowed: of back"):
        found.scan(scan_message())
    assert found.scan(other)[0] == STAMP


def test_what_happens_is_counted_and_said_again_after_ten_seconds():
    lines: list[str] = []
    notices = Notices(lines.append)
    for s in (0, 9.9, 10, 15):
        notices.event("jump", f"jumped at {s} s", 5 + round(s * 1e9))
    for fault in ("found 7, allowed: 5", "found 8, allowed: 5", "found x, allowed: a number"):
        notices.drop("scan unusable", fault)
    for _ in range(3):
        notices.drop("scan late")
    assert lines == [
        "jumped at 0 s", "jumped at 10 s", "dropped: scan unusable: found 7, allowed: 5",
        "dropped: scan unusable: found x, allowed: a number", "dropped: scan late",
    ]  # fmt: skip
    assert notices.summary() == "jump 4, scan late 3, scan unusable 3"


@pytest.mark.parametrize("changes", [
    {"angle_min": math.nan}, {"angle_increment": 0.0}, {"ranges": np.zeros(1, np.float32)},
    {"ranges": np.zeros(100_001, np.float32), "angle_increment": 1e-5}, {"header": MAKE.header(0, "laser")},
    {"header": ill_stamped()}, {"range_max": 1001.0},
])  # fmt: skip
def test_a_scan_with_numbers_that_are_not_allowed_is_named(changes):
    with pytest.raises(ValueError, match=r"found .*, allowed: "):
        laser().scan(scan_message(**changes))


def pose_message(frame: str = "map") -> bytes:
    message = MAKE.estimate(STAMP, Pose(1.2, -3.4, 0.7), 0.1 * np.eye(3))
    message.header.frame_id = frame
    return MAKE.serialized(message, POSE)


READS = {
    LASER_SCAN: (scan_message(), lambda: laser().scan),
    ODOMETRY: (ODOMETRY_MESSAGE, lambda: MessageReader().odometry),
    TRANSFORMS: (
        MAKE.serialized(MAKE.transform(STAMP, "a", "b", Pose()), TRANSFORMS),
        lambda: lambda data: MessageReader().add_transforms(data, TransformTree()),
    ),
    TWIST: (MAKE.serialized(MAKE.twist(1.0, 2.0), TWIST), lambda: MessageReader().command),
    POSE: (pose_message(), lambda: MessageReader().pose_in_map),
}


@pytest.mark.parametrize("name", READS)
def test_damaged_bytes_are_a_value_error(name):
    whole, reader = READS[name]
    rng, read = np.random.default_rng(7), reader()
    for _ in range(100):
        data = bytearray(whole[: rng.integers(0, len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(0, 6) if data else 0):
            data[rng.integers(0, min(len(data), 120))] = rng.integers(0, 256)
        try:
            read(bytes(data))
        except ValueError as error:
            assert "\n" not in str(error)


def test_a_pose_of_a_user_is_in_the_frame_of_the_map():
    assert MessageReader().pose_in_map(pose_message("/map")).array() == pytest.approx((1.2, -3.4, 0.7))
    with pytest.raises(ValueError, match="in the frame odom, allowed: in map"):
        MessageReader().pose_in_map(pose_message("odom"))
