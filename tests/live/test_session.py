"""A simulated robot and who listens to it, on this machine's network: what each takes of the other."""

import math
import os
import threading
from types import SimpleNamespace
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
from sixthsense.live.network import SENSOR, Endpoint, Message, Network, Node
from sixthsense.live.reading import POSE, TWIST, MessageReader
from sixthsense.live.session import Session, Topics, _where, check_drive
from sixthsense.live.simulated import SimulatedRobot
from sixthsense.logs.ros_messages import TransformTree, stamp_ns
from sixthsense.record.messages import Messages
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.mapping.grid import Grid

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install -e '.[ros2]'")

DOMAIN = 100 + os.getpid() % 40
LASER = {"beams": 90, "fov": 4.0, "max_range": 7.5, "mount": (0.12, -0.08, 0.6), "period_ticks": 6, "sweep_s": 0.03}
START = Pose(0.4, -0.3, 0.7)


def test_a_robot_sends_what_its_world_gives_and_who_listens_is_configured_by_it(tmp_path, monkeypatch):
    node = Node(Network(DOMAIN))  # of both: a process joins a domain once
    for module in (simulated, session_module):
        monkeypatch.setattr(module, "Node", lambda _: node)
    config = preset(laser=LASER, robot={"control_period_s": 0.02}, world={"motion": {"speed": 0.4}})
    world = World(load_scene("rectangle").walls, START, 0.2, config, np.random.default_rng(0))
    is_over, ticks = threading.Event(), []
    with (
        SimulatedRobot(Network(DOMAIN), config, True) as robot,
        Session(Network(DOMAIN), Topics().checked(), preset("log"), lambda _: None) as session,
    ):
        odometry, frames = node.reader(simulated.ODOM), node.reader(simulated.TF_STATIC)
        scans = node.reader(simulated.SCAN._replace(quality=SENSOR))
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
        commands = node.writer(simulated.CMD_VEL)
        wait_until(lambda: commands.readers == 1)
        for speed in (0.1, 0.2, 0.3):
            commands.send(Messages().serialized(Messages().twist(speed, -0.7), TWIST))
        found = []
        wait_until(lambda: found.append(robot.command()) or found[-1] == Command(0.3, -0.7))
        reader, tree = MessageReader(), TransformTree()
        (link,) = frames.take()
        reader.add_transforms(link, tree)
        sent = [reader.odometry(data) for data in odometry.take()]
        stamps = {stamp_ns(reader.read(data, simulated.SCAN.type)) for data in scans.take()}
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
    at = "frame `map`, outside of all that was seen; the robot is at 1.00 0.25"
    assert _where(config, trace) == f"the goal is at 7.00 -9.50, {at}"
    assert "outside" not in _where(config.replaced(goal=(1.0, -0.5)), trace)


def test_the_map_begins_at_the_newest_pose_that_is_set_and_one_of_a_run_is_named(joined):
    make = Messages()
    poses = [make.estimate(7, pose, np.eye(3)) for pose in (Pose(1.5, 2.0, 0.5), Pose(-3.0, 5.0, 2.2))]
    sent = [Message(make.serialized(pose, POSE), "rviz") for pose in poses]
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
