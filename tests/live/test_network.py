"""Topics on a real network of this machine: their bytes, who else is there, what is not read, and what each takes."""

import math
import os
import subprocess
import sys
import threading
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from processes import wait_until

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.live import session as session_module
from sixthsense.live import simulated
from sixthsense.live.network import SENSOR, Endpoint, Message, Network, Node, dds_type
from sixthsense.live.publishing import MAP
from sixthsense.live.reading import POSE, TRANSFORMS, TWIST, TWIST_STAMPED, LaserReader, MessageReader, Notices
from sixthsense.live.session import Session, Topics, _where, check_drive, check_one_publisher, command_type
from sixthsense.live.simulated import CMD_VEL, ODOM, SCAN, SimulatedRobot, check_alone
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, TransformTree, stamp_ns
from sixthsense.record.messages import Messages
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.mapping.grid import Grid

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


LASER = {"beams": 90, "fov": 4.0, "max_range": 7.5, "mount": (0.12, -0.08, 0.6), "period_ticks": 6, "sweep_s": 0.03}


def test_a_robot_sends_what_its_world_gives_and_who_listens_is_configured_by_it(node, tmp_path, monkeypatch):
    for module in (simulated, session_module):
        monkeypatch.setattr(module, "Node", lambda _: node)
    config = preset(laser=LASER, robot={"control_period_s": 0.02}, world={"motion": {"speed": 0.4}})
    world = World(load_scene("rectangle").walls, Pose(0.4, -0.3, 0.7), 0.2, config, np.random.default_rng(0))
    is_over, ticks = threading.Event(), []
    with (
        SimulatedRobot(Network(DOMAIN), config, True) as robot,
        Session(Network(DOMAIN), Topics().checked(), preset("log"), lambda _: None) as session,
    ):
        odometry, frames = node.reader(ODOM), node.reader(simulated.TF_STATIC)
        scans = node.reader(SCAN._replace(quality=SENSOR))
        robot.begin(tmp_path / "truth.tum")

        def drive() -> None:
            while not is_over.wait(0.02):
                tick = world.step(Command(0.03, 0.4))
                robot.send(tick)
                ticks.append(tick)

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            session.configure(True)
            driven = session.config
            session.config = driven.replaced(laser=driven.laser.replaced(mount=(0.3, 0.4, -0.5), max_range=3.5))
            session.configure(False)
        finally:
            is_over.set()
            thread.join()
        wait_until(lambda: robot.command() is None)
        commands = node.writer(CMD_VEL)
        wait_until(lambda: commands.readers == 1)
        for speed in (0.1, 0.2, 0.3):
            commands.send(MAKE.serialized(MAKE.twist(speed, -0.7), TWIST))
        found = []
        wait_until(lambda: found.append(robot.command()) or found[-1] == Command(0.3, -0.7))
        reader, tree = MessageReader(), TransformTree()
        (link,) = frames.take()
        reader.add_transforms(link, tree)
        sent = [reader.odometry(data) for data in odometry.take()]
        stamps = {stamp_ns(reader.read(data, SCAN.type)) for data in scans.take()}
    assert tree.mount("base_link", "laser")[0].array() == pytest.approx(LASER["mount"])
    laser = driven.laser
    assert (laser.beams, laser.max_range, *laser.mount, laser.fov) == pytest.approx((90, 7.5, *LASER["mount"], 4.0))
    # A command is followed within 0.1 s, and the laser's period of at least 0.12 s is that of its stamps.
    assert driven.robot.control_period_s == 0.1 and laser.period_ticks == 2
    assert (session.config.laser.mount, session.config.laser.max_range) == ((0.3, 0.4, -0.5), 3.5)
    began_ns = sent[-1].stamp_ns - ticks[-1].stamp_ns
    by_stamp = {tick.stamp_ns + began_ns: tick for tick in ticks}
    assert len(sent) > 20
    for at in sent:
        np.testing.assert_allclose(by_stamp[at.stamp_ns].odometry.array(), at.T_odom_robot.array(), atol=1e-12)
    first_beams = {at - round(0.03 * 1e9 * 89 / 90) for at, tick in by_stamp.items() if tick.scan is not None}
    assert len(stamps) > 5 and all(min(abs(at - first) for first in first_beams) <= 10 for at in stamps)
    truth = np.loadtxt(tmp_path / "truth.tum")
    assert len(truth) == len(ticks)
    for (_, x, y, _, _, _, z, w), tick in zip(truth, ticks, strict=True):
        assert (x, y, 2.0 * math.atan2(z, w)) == pytest.approx(tuple(tick.truth.array()), abs=1e-6)
    assert ticks[-1].truth.theta != ticks[-1].odometry.theta


def test_a_drive_needs_the_places_of_its_task():
    region, tour = (0.5, 0.6, 2.0, 3.0), ((2.0, 3.0),)
    for task, name, place in (("explore", "region", region), ("goal", "goal", tour[0]), ("tour", "tour", tour)):
        with pytest.raises(InputError, match=f"^{name}: missing"):
            check_drive(preset(task=task))
        check_drive(preset(task=task, **{name: place}))


@pytest.mark.parametrize(("interface", "named", "multicast", "peers"), [
    ("127.0.0.1", "address", "false", ["127.0.0.1"]), ("lo", "name", "false", ["127.0.0.1"]),
    ("192.168.1.7", "address", "spdp", []), ("eth0", "name", "spdp", []),
])  # fmt: skip
def test_a_network_is_found_by_multicast_unless_it_is_this_machine(interface, named, multicast, peers):
    root = ElementTree.fromstring(Network(7, interface).xml())
    assert root.findtext("Domain/General/AllowMulticast") == multicast
    assert [peer.get("address") for peer in root.iter("Peer")] == peers
    assert [one.attrib for one in root.iter("NetworkInterface")] == [{named: interface}]


@pytest.fixture
def joined(monkeypatch):
    """Joins a network on which nothing is sent, but for what is given."""

    def join(**of):
        node = SimpleNamespace(**{"leak": "", "reader": lambda _: None, "close": lambda: None} | of)
        monkeypatch.setattr(session_module, "Node", lambda _: node)
        monkeypatch.setattr(session_module, "is_command_ended", lambda: True)
        lines = []
        return Session(Network(), Topics(), preset("log"), lines.append), lines

    return join


def test_a_loopback_that_others_may_reach_is_told_and_no_robot_is_driven_there(joined):
    session, lines = joined(leak="found the loopback")
    for drive, error in ((True, InputError), (False, KeyboardInterrupt)):
        with pytest.raises(error, match=r"^interface: found the loopback|^$"):
            session.configure(drive)
    assert lines[0] == "interface: found the loopback"


def test_topics_that_do_not_come_are_named_with_those_that_do(joined):
    session, lines = joined(publishers=lambda: [Endpoint("/front", "sensor_msgs/msg/LaserScan")])
    session._say_missing(True, False, True)
    said = "nothing on /scan and nobody who reads /cmd_vel yet (seen: /front (LaserScan))"
    assert lines == [f"{said}; other networks: `interface`, `domain`"]


def test_a_goal_outside_of_all_that_was_seen_is_named_with_its_frame_and_where_the_robot_is():
    config = preset(task="goal", goal=(7.0, -9.5))
    grid = Grid(config.grid, 0.2)
    grid.add(Pose(), Scan(np.full(90, 3.0, dtype=np.float32), np.float32(-3.1), np.float32(0.07), 9.0))
    trace = SimpleNamespace(estimates=[(1.0, 0.25, 0.3)], draw_map=lambda: grid)
    at = "frame map, outside of all that was seen; the robot is at 1.00 0.25"
    assert _where(config, trace) == f"the goal is at 7.00 -9.50, {at}"
    assert "outside" not in _where(config.replaced(goal=(1.0, -0.5)), trace)


def test_the_map_begins_at_the_newest_pose_that_is_set_and_one_of_a_run_is_named(joined):
    poses = [MAKE.estimate(7, pose, np.eye(3)) for pose in (Pose(1.5, 2.0, 0.5), Pose(-3.0, 5.0, 2.2))]
    sent = [Message(MAKE.serialized(pose, POSE), "rviz") for pose in poses]
    reader = SimpleNamespace(topic=SimpleNamespace(name="/initialpose"), messages=lambda: sent, take=lambda: sent)
    session, lines = joined(reader=lambda _: reader)
    assert session._start().array() == pytest.approx((-3.0, 5.0, 2.2))
    session._refuse_start(Tick(7, Pose()), None)
    assert lines[1] == "the map begins at -3.00 m, 5.00 m, 126°" and lines[2].startswith("a pose is left out")


@pytest.mark.parametrize(("of", "said"), [
    ((233,), "domain: found 233, allowed: 0 to 232"), ((7, "eth9"), "interface: found 'eth9', allowed: lo"),
    ((7, "999.1.1.1"), "interface: found '999.1.1.1', allowed: lo"),
])  # fmt: skip
def test_a_network_that_cannot_be_is_refused(of, said):
    with pytest.raises(InputError, match=said):
        Node(Network(*of))
