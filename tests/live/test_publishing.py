"""What a live run tells the network: commands and what stops them, the map, the verdict; and what it finds odd."""

import math
import threading
import time
from collections import defaultdict
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driven import config, mirrored, ticks
from general import covariances, poses, some
from hypothesis import given
from processes import wait_until

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.live import publishing
from sixthsense.live.publishing import LEVELS, LOOK_NS, MAP, Commands, MapSender, diagnostics, first_look, publisher
from sixthsense.live.reading import TWIST_STAMPED, MessageReader, Notices
from sixthsense.live.robot import LiveRobot
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import stamp_ns
from sixthsense.loop.run import replay
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import DIAGNOSTICS, Messages
from sixthsense.slam.mapping.grid import Grid, Walls
from sixthsense.slam.mapping.mapper import Mapper

MAKE = Messages()
MS, HOUR = 1_000_000, 3_600_000_000_000
CONFIG = preset(grid={"cell_m": 0.15})


@pytest.mark.parametrize("command", [Command(0.37, 0.0), Command(0.0, -0.62), Command(-0.37, 0.62)])
def test_a_loop_that_stalls_stops_a_moving_robot_once_and_the_end_does(command, monkeypatch):
    clock, sent = SimpleNamespace(now=7.0, sleep=lambda _: None), []
    clock.monotonic = lambda: clock.now
    monkeypatch.setattr(publishing, "time", clock)
    with Commands(lambda data: sent.append(MessageReader().command(data))) as commands:
        commands.send(command)
        clock.now += 0.29
        time.sleep(0.15)  # the thread has looked meanwhile
        assert sent == [command]
        clock.now += 0.02
        wait_until(lambda: len(sent) == 2)
        clock.now += 9.0
        time.sleep(0.15)
        assert sent == [command, Command()]
        commands.send(command)
    assert sent[2:] == [command, Command(), Command(), Command()]


def test_a_stamped_command_has_the_time_of_the_robots_clock_and_its_frame():
    sent = []
    Commands(sent.append, lambda: 1_700_000_000_123_456_789, "chassis").send(Command(0.37, -0.62))
    message = MessageReader().read(sent[0], TWIST_STAMPED)
    assert (stamp_ns(message), message.header.frame_id) == (1_700_000_000_123_456_789, "chassis")
    assert MessageReader().command(sent[0], TWIST_STAMPED) == Command(0.37, -0.62)


def a_scan(rng: np.random.Generator) -> Scan:
    return Scan(rng.uniform(1.0, 5.0, 200).astype(np.float32), np.float32(-2.9), np.float32(0.029), 9.0)


def trace_of(mapper: Mapper) -> Any:
    return SimpleNamespace(config=CONFIG, radius_m=0.2, key_stamps_ns=[], live=SimpleNamespace(mapper=mapper))


@pytest.mark.parametrize("is_prior", [False, True])
def test_the_thread_sends_the_map_that_the_run_would_draw_and_nothing_that_is_not_new(is_prior, monkeypatch):
    monkeypatch.setattr(publishing, "_PERIOD_S", 0.0)
    rng, sent, own = np.random.default_rng(4), list[Any](), Mapper(CONFIG.grid, 0.2)
    if is_prior:
        earlier = Grid(CONFIG.grid, 0.2)
        earlier.add(Pose(1.3, 5.2, 0.3), a_scan(rng))
        own.start_from(earlier.submap())
    trace, trajectory = trace_of(own), np.zeros((0, 3))
    with ThreadPoolExecutor(1) as thread:
        drawings: list[Future[None]] = []

        def submit(*given: Any) -> Future[None]:
            drawings.append(thread.submit(*given))
            return drawings[-1]

        hook = MapSender(lambda data: sent.append(MAKE.store.deserialize_cdr(data, MAP.type)), submit)
        for count in (1, 4, 13, 14, 31):
            for k in range(len(trajectory), count):
                here = Pose(0.4, -0.3, 0.7) @ Pose(0.21 * k, 0.03 * k, 0.17 * k)
                trajectory = np.vstack([trajectory + 0.004 * rng.standard_normal((k, 3)), here.array()])
                walls = Walls(np.array([[[1.1, 2.2], [3.1, 2.4]]]), np.zeros((0, 2, 2)))
                own.add(k, trajectory.copy, a_scan(rng), walls)
                trace.key_stamps_ns.append(k)
            for _again in range(2):
                hook(Tick(1_700_000_000_123_456_789 + count, Pose()), trace)
            drawings[-1].result()
            grid, info = own.draw(), sent[-1].info
            np.testing.assert_array_equal(sent[-1].data.reshape(info.height, info.width), grid.occupancy())
            assert (info.origin.position.x, info.origin.position.y) == grid.origin
            assert stamp_ns(sent[-1]) == 1_700_000_000_123_456_789 + count
    assert len(sent) == 5


def test_what_ends_the_thread_of_the_map_ends_the_run(monkeypatch):
    monkeypatch.setattr(publishing, "_PERIOD_S", 0.0)
    broken: Future[None] = Future()
    broken.set_exception(OSError("no memory"))
    hook, trace = MapSender(print, lambda *given: broken), trace_of(Mapper(CONFIG.grid, 0.2))
    trace.key_stamps_ns.append(1)
    hook(Tick(1, Pose()), trace)
    trace.key_stamps_ns.append(2)
    with pytest.raises(OSError, match="no memory"):
        hook(Tick(2, Pose()), trace)


def told(own):
    """The messages of a replay, its verdict at the end, and the paces after each message."""
    pilot, sent, paces = Pilot(Navigator(), Guard(config(), 0.2)), [], []

    def send(data: bytes) -> None:
        sent.append(MAKE.store.deserialize_cdr(data, DIAGNOSTICS))
        paces.append(pilot.pace)

    trace = replay(Log(own), config(), on_tick=diagnostics(send, pilot))
    return sent, trace.verdict, paces


@pytest.mark.parametrize(("own", "level", "pace"), [(ticks, "good", 1.0), (mirrored, "broken", 0.0)])
def test_a_good_map_is_driven_by_at_full_speed_and_at_one_of_a_mirrored_laser_the_robot_turns_in_place(
    own, level, pace
):
    sent, verdict, paces = told(own())
    first, last, duration_s = own()[0], sent[-1].status[0], 1e-9 * (own()[-1].stamp_ns - own()[0].stamp_ns)
    assert duration_s / 1.3 < len(sent) <= duration_s + 1  # once a second
    assert (verdict.level, last.level, paces[-1]) == (level, LEVELS[level], pace)
    assert stamp_ns(sent[0]) == first.stamp_ns and last.name == "sixthsense: map"
    if level == "good":
        assert {message.status[0].level for message in sent} == {0} and set(paces) == {1.0}
    else:
        assert "is the laser mirrored?" in last.message and last.values[0].value == "mirrored"


def said_by(own, seconds):
    """What the first look says of the first seconds."""
    lines = []
    hook = first_look(lines.append)
    for tick in own:
        if tick.stamp_ns - own[0].stamp_ns <= 1e9 * seconds:
            hook(tick, None)
    for thread in threading.enumerate():
        if thread.name == "first look":
            thread.join()
    return lines


def test_a_laser_from_right_to_left_is_said_once_and_one_that_is_right_never():
    later_s = 1e-9 * LOOK_NS + 1.0
    assert said_by(mirrored(), later_s - 2.0) == [] == said_by(ticks(), later_s + 9.0)
    (line,) = said_by(mirrored(), later_s + 9.0)
    assert "scans turn against the odometry" in line


@some
@given(poses, poses, covariances, poses, covariances, poses)
def test_what_is_published_is_the_pose_its_covariance_and_the_frame_of_odometry(
    T_joined_odom, key, key_cov, since, since_cov, odometry
):
    robot, estimate, sent = LiveRobot(lambda _: (), Notices(print), preset("log")), key @ since, defaultdict(list)

    def advertise(topic: Any) -> Any:
        keep = sent[topic.name].append
        return SimpleNamespace(send=lambda data: keep(MAKE.store.deserialize_cdr(data, topic.type)))

    robot.joiner.T_joined_odom, robot.odom_frame = T_joined_odom, "wheels"
    trace: Any = SimpleNamespace(
        estimates=[(7.0, 8.0, 2.0), estimate.array()], since_key=[(7.0, 8.0, 2.0), since.array()], plans=[],
        key_estimates=[None, SimpleNamespace(pose=key, pose_cov=key_cov)], live=SimpleNamespace(since_cov=since_cov),
    )  # fmt: skip
    time_ns = 2 * HOUR + 123_456_789
    publish = publisher(advertise, robot)
    publish(Tick(time_ns, odometry), trace)
    assert not any(sent.values())
    publish(Tick(time_ns, odometry, a_scan(np.random.default_rng(1))), trace)
    trace.plans.append(np.array([[1.5, 2.5], [3.5, -0.5], [4.5, 0.7]]))
    for _ in range(2):
        publish(Tick(time_ns + 1, odometry), trace)
    (plan,) = sent["/plan"]
    found = [(at.pose.position.x, at.pose.position.y) for at in plan.poses]
    assert found == [(1.5, 2.5), (3.5, -0.5), (4.5, 0.7)] and plan.header.frame_id == "map"
    (pose,), ((link,),) = sent["/pose"], (message.transforms for message in sent["/tf"])
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
