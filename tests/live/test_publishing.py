"""What a live run tells the network: commands and what stops them, the map, the verdict; and what it finds odd."""

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driven import config, mirrored, ticks
from processes import wait_until

import sixthsense as ss
from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.live import publishing
from sixthsense.live.publishing import (
    LEVELS,
    LOOK_NS,
    MAP,
    Commands,
    MapSender,
    diagnostics,
    first_look,
    pose_covariance,
)
from sixthsense.live.reading import TWIST_STAMPED, MessageReader
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import stamp_ns
from sixthsense.loop.run import replay
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import DIAGNOSTICS, Messages
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.grid import Grid, Walls
from sixthsense.slam.mapping.mapper import Mapper

MAKE = Messages()
CONFIG = preset(grid={"cell_m": 0.15})


def test_before_the_first_keyframe_nothing_is_known():
    assert not pose_covariance(Trace(ss.preset(), None, 0.2)).any()


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


@pytest.mark.parametrize("is_prior", [False, True])
def test_the_thread_sends_the_map_that_the_run_would_draw_and_nothing_that_is_not_new(is_prior, monkeypatch):
    monkeypatch.setattr(publishing, "_PERIOD_S", 0.0)
    rng, sent, own = np.random.default_rng(4), list[Any](), Mapper(CONFIG.grid, 0.2)
    if is_prior:
        earlier = Grid(CONFIG.grid, 0.2)
        earlier.add(Pose(1.3, 5.2, 0.3), a_scan(rng))
        own.start_from(earlier.submap())
    trace: Any = SimpleNamespace(config=CONFIG, radius_m=0.2, key_stamps_ns=[], live=SimpleNamespace(mapper=own))
    trajectory = np.zeros((0, 3))
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
    hook = MapSender(print, lambda *given: broken)
    trace: Any = SimpleNamespace(
        config=CONFIG, radius_m=0.2, key_stamps_ns=[1], live=SimpleNamespace(mapper=Mapper(CONFIG.grid, 0.2))
    )
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


def test_a_good_map_is_ok_once_a_second_and_driven_by_at_full_speed():
    own = ticks()
    sent, verdict, paces = told(own)
    duration_s = 1e-9 * (own[-1].stamp_ns - own[0].stamp_ns)
    assert duration_s / 1.3 < len(sent) <= duration_s + 1
    assert {message.status[0].level for message in sent} == {0} and set(paces) == {1.0}
    assert verdict.level == "good" and sent[-1].status[0].message == "map good"
    assert stamp_ns(sent[0]) == own[0].stamp_ns and sent[0].status[0].name == "sixthsense: map"


def test_a_mirrored_laser_is_an_error_that_names_it_and_the_robot_turns_in_place():
    sent, verdict, paces = told(mirrored())
    last = sent[-1].status[0]
    assert verdict.level == "broken" and last.level == LEVELS["broken"] and paces[-1] == 0.0
    assert "is the laser mirrored?" in last.message
    assert {pair.key: pair.value for pair in last.values}["cause"] == "mirrored"


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
