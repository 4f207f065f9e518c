"""Who else is on a robot's topics."""

import os
import time
from collections.abc import Callable
from importlib.util import find_spec

import pytest

from sixthsense.core.geometry import Pose
from sixthsense.live.network import Network, Node
from sixthsense.live.others import check_alone, check_one_publisher, command_type
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.live.simulated import ODOM, SCAN, cmd_vel
from sixthsense.live.topics import NetworkError
from sixthsense.record.messages import Messages

needs_dds = pytest.mark.skipif(
    find_spec("cyclonedds") is None, reason="needs Cyclone DDS: pip install 'sixthsense[ros2]'"
)


@pytest.fixture
def node():
    with Node(Network(100 + os.getpid() % 40)) as found:
        yield found


def wait_for(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120.0
    while not is_so():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.01)


@needs_dds
def test_two_publishers_of_a_topic_are_refused(node):
    reader = node.reader(SCAN)
    check_one_publisher(reader)
    node.writer(SCAN)
    wait_for(lambda: reader.publishers == 1)
    check_one_publisher(reader)
    node.writer(SCAN)
    wait_for(lambda: reader.publishers == 2)
    with pytest.raises(NetworkError, match="/scan: found 2 publishers, allowed: one robot"):
        check_one_publisher(reader)


@needs_dds
@pytest.mark.parametrize(
    ("topics", "message"),
    [
        ((cmd_vel(TWIST), cmd_vel(TWIST_STAMPED)), "/cmd_vel: found 2 subscribers, allowed: one"),
        (
            (cmd_vel()._replace(type=ODOM.type),),
            "/cmd_vel: found a subscriber of 'nav_msgs/msg/Odometry', allowed: geo",
        ),
    ],
)
def test_a_robot_that_cannot_be_driven_alone_is_refused(node, topics, message):
    for topic in topics:
        node.reader(topic)
    wait_for(lambda: len(node.subscribers("/cmd_vel")) == len(topics))
    with pytest.raises(NetworkError, match=message):
        command_type(node, "/cmd_vel", False)


@needs_dds
@pytest.mark.parametrize(
    ("announce", "message"),
    [
        (lambda node: node.writer(SCAN), "/scan: found another publisher, allowed: one robot or simulator"),
        (lambda node: node.writer(ODOM), "/odom: found another publisher"),
        (lambda node: node.reader(cmd_vel()), "/cmd_vel: found another subscriber"),
    ],
)
def test_a_second_simulator_finds_the_topics_of_the_first(node, announce, message):
    check_alone(node, (SCAN, ODOM), (cmd_vel(),))
    announce(node)
    wait_for(lambda: any(node.publishers(name) or node.subscribers(name) for name in ("/scan", "/odom", "/cmd_vel")))
    with pytest.raises(NetworkError, match=message):
        check_alone(node, (SCAN, ODOM), (cmd_vel(),))


@needs_dds
def test_the_messages_of_two_publishers_are_told_apart(node):
    make, reader = Messages(), node.reader(ODOM)
    data = make.serialized(make.odometry(1, Pose(), None), ODOM.type)
    writers = [node.writer(ODOM) for _ in range(2)]
    wait_for(lambda: reader.publishers == 2)
    names: list[str] = []
    for count, writer in enumerate((writers[0], writers[1], writers[0]), start=1):
        writer.send(data)
        while len(names) < count:
            node.wait(0.05)
            names += [message.publisher for message in reader.messages()]
    assert names[0] == names[2] != names[1]
