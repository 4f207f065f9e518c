"""Topics on a real network of this machine, their bytes, who else is there, and which messages are not read."""

import math
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from processes import wait_until

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.live.network import SENSOR, Network, Node, dds_type
from sixthsense.live.publishing import MAP
from sixthsense.live.reading import POSE, TRANSFORMS, TWIST, TWIST_STAMPED, LaserReader, MessageReader, Notices
from sixthsense.live.session import check_one_publisher, command_type
from sixthsense.live.simulated import CMD_VEL, ODOM, SCAN, check_alone
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, TransformTree
from sixthsense.record.messages import Messages

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install -e '.[ros2]'")

MAKE = Messages()
STAMP = 1_700_000_000_123_456_789
DOMAIN = 60 + os.getpid() % 40  # one for each process of tests, as they must not hear each other


@pytest.fixture
def node():
    with Node(Network(DOMAIN)) as found:
        yield found


def scan_message(beams: int = 360, **changes: Any) -> bytes:
    ranges = np.linspace(1.0, 2.0, beams, dtype=np.float32)
    message = MAKE.scan(STAMP, Scan(ranges, np.float32(-math.pi), np.float32(2.0 * math.pi / beams), 10.0))
    for name, value in changes.items():
        setattr(message, name, value)
    return MAKE.serialized(message, LASER_SCAN)


def pose_message(frame: str = "map") -> bytes:
    message = MAKE.estimate(STAMP, Pose(1.2, -3.4, 0.7), 0.1 * np.eye(3))
    message.header.frame_id = frame
    return MAKE.serialized(message, POSE)


def laser(max_range: float | None = None) -> LaserReader:
    return LaserReader(MessageReader(), max_range, Pose(0.2, -0.3, 0.4))


MESSAGES = {
    LASER_SCAN: scan_message(),
    POSE: pose_message(),
    **{name: MAKE.serialized(message, name) for name, message in {
        ODOMETRY: MAKE.odometry(STAMP, Pose(1.0, -2.0, 0.7)),
        TRANSFORMS: MAKE.transform(STAMP, "base_link", "laser", Pose(0.1, 0.0, 3.0)),
        TWIST: MAKE.twist(0.25, -0.5),
        TWIST_STAMPED: MAKE.twist_stamped(STAMP, "base_link", 0.25, -0.5),
        MAP.type: MAKE.occupancy(STAMP, np.array([[0, 100, -1], [-1, 0, 0]], dtype=np.int8), (-1.0, 2.0), 0.05),
    }.items()},
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_the_structure_that_is_announced_has_the_bytes_that_are_sent(name):
    """Cyclone DDS encodes by the structure what `rosbags` encodes by the definition of ROS."""
    data, kind = MESSAGES[name], dds_type(name)
    assert kind.__idl_typename__ == name.replace("/msg/", ".msg.dds_.") + "_"
    again = kind.__idl__.serialize(kind.__idl__.deserialize(data), use_version_2=False)
    assert again == data[: len(again)] and not any(data[len(again) :])


def test_who_comes_late_gets_the_last_map(node):
    writer = node.writer(MAP)
    for k in range(3):
        cells = np.full((200, 300), k, dtype=np.int8)
        writer.send(MAKE.serialized(MAKE.occupancy(STAMP, cells, (0.0, 0.0), 0.05), MAP.type))
    reader = node.reader(MAP)
    got: list[bytes] = []
    wait_until(lambda: got.extend(reader.take()) or got)
    (only,) = got
    message = MAKE.store.deserialize_cdr(only, MAP.type)
    assert (message.info.width, message.info.height) == (300, 200) and set(message.data.tolist()) == {2}


def test_each_of_two_publishers_is_told_apart_by_its_bytes_and_both_are_refused(node):
    reader, data, writers = node.reader(SCAN._replace(quality=SENSOR)), MESSAGES[LASER_SCAN], []
    for count in (1, 2):
        check_one_publisher(node, SCAN.name)
        writers.append(node.writer(SCAN))
        wait_until(lambda: len(node.publishers(SCAN.name)) == count and writers[-1].readers)  # noqa: B023
    with pytest.raises(InputError, match="/scan: found 2 publishers, allowed: one robot"):
        check_one_publisher(node, SCAN.name)
    messages = []
    for count, k in enumerate((0, 1, 0), start=1):
        writers[k].send(data)
        wait_until(lambda: messages.extend(reader.messages()) or len(messages) == count)  # noqa: B023
    names = [message.publisher for message in messages]
    assert names[0] == names[2] != names[1] and all(one.data[: len(data)] == data for one in messages)


@pytest.mark.parametrize(("topics", "message"), [
    ((CMD_VEL, CMD_VEL._replace(type=TWIST_STAMPED)), "/cmd_vel: found 2 subscribers, allowed: one"),
    ((CMD_VEL._replace(type=ODOM.type),), "/cmd_vel: found a subscriber of 'nav_msgs/msg/Odometry', allowed: geo"),
])  # fmt: skip
def test_a_robot_that_cannot_be_driven_alone_is_refused(node, topics, message):
    for topic in topics:
        node.reader(topic)
    wait_until(lambda: len(node.subscribers("/cmd_vel")) == len(topics))
    with pytest.raises(InputError, match=message):
        command_type(node, "/cmd_vel")
    with pytest.raises(InputError, match="/cmd_vel: found another subscriber"):
        check_alone(node, (SCAN, ODOM), (CMD_VEL,))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/net")
def test_no_socket_of_the_default_network_can_be_reached_from_another_machine():
    program = (
        "import socket, os, sys\n"
        "from sixthsense.live.network import *\n"
        "with Node(Network(int(sys.argv[1]))) as node:\n"
        "    for name in os.listdir('/proc/self/fd'):\n"
        "        try: found = socket.socket(fileno=os.dup(int(name)))\n"
        "        except OSError: continue\n"
        "        device = found.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)\n"
        "        print(found.getsockname()[0], device.rstrip(bytes(1)).decode() or '-')\n"
    )
    out = subprocess.run([sys.executable, "-c", program, str(DOMAIN)], capture_output=True, text=True, check=True)
    places = [line.split() for line in out.stdout.splitlines()]
    assert len(places) >= 2
    assert all(address.startswith("127.") or device == "lo" for address, device in places)


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
        MessageReader().odometry(MESSAGES[ODOMETRY].ljust(1048577, b"\0"))
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


def ill_stamped() -> Any:
    header = MAKE.header(STAMP, "laser")
    header.stamp.nanosec = 1_000_000_000
    return header


@pytest.mark.parametrize("changes", [
    {"angle_min": math.nan}, {"angle_increment": 0.0}, {"ranges": np.zeros(1, np.float32)},
    {"ranges": np.zeros(100_001, np.float32), "angle_increment": 1e-5}, {"header": MAKE.header(0, "laser")},
    {"header": ill_stamped()}, {"range_max": 1001.0},
])  # fmt: skip
def test_a_scan_with_numbers_that_are_not_allowed_is_named(changes):
    with pytest.raises(ValueError, match=r"found .*, allowed: "):
        laser().scan(scan_message(**changes))


READS = {
    LASER_SCAN: lambda: laser().scan,
    ODOMETRY: lambda: MessageReader().odometry,
    TRANSFORMS: lambda: lambda data: MessageReader().add_transforms(data, TransformTree()),
    TWIST: lambda: MessageReader().command,
    POSE: lambda: MessageReader().pose_in_map,
}


@pytest.mark.parametrize("name", READS)
def test_damaged_bytes_are_a_value_error(name):
    whole, rng, read = MESSAGES[name], np.random.default_rng(7), READS[name]()
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
