"""Topics on a real network of this machine, their bytes, and who else is there."""

import os
import subprocess
import sys

import numpy as np
import pytest
from processes import wait_until

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.live.network import SENSOR, Network, Node, dds_type
from sixthsense.live.publishing import MAP, POSE
from sixthsense.live.reading import TRANSFORMS, TWIST, TWIST_STAMPED
from sixthsense.live.session import check_one_publisher, command_type
from sixthsense.live.simulated import CMD_VEL, ODOM, SCAN, check_alone
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.record.messages import Messages

MAKE = Messages()
STAMP = 1_700_000_000_123_456_789
DOMAIN = 60 + os.getpid() % 40  # one for each process of tests, as they must not hear each other

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install -e '.[ros2]'")


@pytest.fixture
def node():
    with Node(Network(DOMAIN)) as found:
        yield found


def a_scan(beams: int = 360) -> Scan:
    ranges = np.linspace(0.5, 8.0, beams, dtype=np.float32)
    return Scan(ranges, np.float32(-np.pi), np.float32(2.0 * np.pi / beams), 10.0)


MESSAGES = {
    LASER_SCAN: MAKE.scan(STAMP, a_scan()),
    ODOMETRY: MAKE.odometry(STAMP, Pose(1.0, -2.0, 0.7)),
    TRANSFORMS: MAKE.transform(STAMP, "base_link", "laser", Pose(0.1, 0.0, 3.0)),
    TWIST: MAKE.twist(0.25, -0.5),
    TWIST_STAMPED: MAKE.twist_stamped(STAMP, "base_link", 0.25, -0.5),
    POSE.type: MAKE.estimate(STAMP, Pose(1.0, 2.0, 3.0), np.diag([0.1, 0.2, 0.3])),
    MAP.type: MAKE.occupancy(STAMP, np.array([[0, 100, -1], [-1, 0, 0]], dtype=np.int8), (-1.0, 2.0), 0.05),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_the_structure_that_is_announced_has_the_bytes_that_are_sent(name):
    """Cyclone DDS encodes by the structure what `rosbags` encodes by the definition of ROS."""
    data = MAKE.serialized(MESSAGES[name], name)
    kind = dds_type(name)
    assert kind.__idl_typename__ == name.replace("/msg/", ".msg.dds_.") + "_"
    read = kind.__idl__.deserialize(data)
    again = kind.__idl__.serialize(read, use_version_2=False)
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


def test_two_publishers_of_a_topic_are_refused(node):
    for count in (1, 2):
        check_one_publisher(node, SCAN.name)
        node.writer(SCAN)
        wait_until(lambda: len(node.publishers(SCAN.name)) == count)  # noqa: B023
    with pytest.raises(InputError, match="/scan: found 2 publishers, allowed: one robot"):
        check_one_publisher(node, SCAN.name)


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


def test_what_is_sent_arrives_byte_by_byte_and_is_told_apart_by_who_sends_it(node):
    reader, data = node.reader(SCAN._replace(quality=SENSOR)), MAKE.serialized(MESSAGES[LASER_SCAN], LASER_SCAN)
    writers = [node.writer(SCAN) for _ in range(2)]
    wait_until(lambda: len(node.publishers(SCAN.name)) == 2 and all(writer.readers for writer in writers))
    messages = []
    for count, writer in enumerate((writers[0], writers[1], writers[0]), start=1):
        writer.send(data)
        while len(messages) < count:
            node.wait(0.05)
            messages += reader.messages()
    names = [message.publisher for message in messages]
    assert names[0] == names[2] != names[1] and all(one.data[: len(data)] == data for one in messages)


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
