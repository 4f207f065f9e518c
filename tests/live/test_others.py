"""Who else is on a robot's topics."""

import os
import time
from collections.abc import Callable
from importlib.util import find_spec

import pytest

from sixthsense.core.geometry import Pose
from sixthsense.live.network import Network, Node
from sixthsense.live.others import Publishers, check_alone, check_one_publisher, command_type
from sixthsense.live.presence import SILENT_NS
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.live.simulated import ODOM, SCAN, cmd_vel
from sixthsense.live.topics import NetworkError
from sixthsense.record.messages import Messages

MS = 1_000_000
SILENT_MS = SILENT_NS // MS

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


def heard(*messages: tuple[str, int]) -> list[str]:
    """What is said of messages of a publisher at a time in milliseconds."""
    publishers = Publishers()
    return [publishers.heard(name, ms * MS) for name, ms in messages]


def test_one_publisher_stays_known_over_any_pause():
    assert set(heard(("a", 0), ("a", 100), ("a", 90_000), ("a", 90_100))) == {"known"}


def test_a_publisher_that_sends_beside_the_first_is_not_used_and_named_at_the_next_message_of_the_first():
    assert heard(("a", 0), ("b", 50), ("b", 90), ("a", 100)) == ["known", "unknown", "unknown", "second"]


def test_a_publisher_that_follows_one_which_has_fallen_silent_takes_its_place():
    said = heard(("a", 0), ("b", SILENT_MS + 1), ("b", SILENT_MS + 21), ("c", 90_000))
    assert said == ["known", "new", "known", "new"]


def test_one_that_is_back_beside_the_one_in_its_place_is_the_second():
    assert heard(("a", 0), ("b", SILENT_MS + 1), ("a", SILENT_MS + 50))[-1] == "second"


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
@pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])
def test_commands_have_the_type_that_the_robot_subscribes(node, kind):
    assert command_type(node, "/cmd_vel", False) is None
    node.reader(cmd_vel(kind))
    wait_for(lambda: command_type(node, "/cmd_vel", False) == kind)


@needs_dds
def test_a_stamp_is_not_forced_on_a_robot_that_takes_twist(node):
    node.reader(cmd_vel(TWIST))
    message = "--cmd-vel-stamped: found a subscriber of geometry_msgs/msg/Twist on /cmd_vel, allowed: without"
    with pytest.raises(NetworkError, match=message):
        wait_for(lambda: command_type(node, "/cmd_vel", True))


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
def test_of_two_simulators_that_begin_at_once_the_one_with_the_smaller_identifier_stays(node):
    node.writer(SCAN)
    wait_for(lambda: node.publishers("/scan"))
    check_alone(node, (SCAN,), (), before=node.participant)
    with pytest.raises(NetworkError):
        check_alone(node, (SCAN,), (), before="~")


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
