"""A live robot without a network and without a clock: what it makes of messages, when it stops, and how it is found."""

import gc
import math
import threading
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from sixthsense.config import merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.live.ahead_pilot import AheadPilot
from sixthsense.live.network import Message
from sixthsense.live.reading import LaserReader, MessageReader, Notices
from sixthsense.live.requests import Pause, Request, Reset, SetPose
from sixthsense.live.robot import LiveRobot, Steering, placed
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.loop.run import recorded_drive
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import Messages
from sixthsense.record.trace import Trace
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam

MS = 1_000_000
BEGAN = 1_700_000_000_000 * MS
MAKE = Messages()
CONFIG = preset("log", robot={"speed": 0.5}, laser={"beams": 180})
CORNERS = [(0, 0), (9, 0), (9, 4), (6, 4), (6, 7), (3, 7), (3, 5), (0, 5)]
WALLS = np.array([CORNERS, np.roll(CORNERS, -1, axis=0).tolist()], dtype=np.float64).transpose(1, 0, 2)
START, ELSEWHERE = Pose(2.0, 1.0), Pose(7.0, 2.0, 2.0)
PAUSE_MS = 7000
T_MAP_ODOM = Pose(1.5, -0.7, 0.8)  # the map is not in the frame of odometry, as with the map of an earlier run


def taken(requests: list[Request]) -> list[Request]:
    """The requests, which are then gone."""
    found, requests[:] = requests[:], []
    return found


class Forward(Navigator):
    """Drives forward always."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.2, 0.0)


class Bench:
    """A robot on an arc, and whose sensors can be switched off; time passes while it waits."""

    def __init__(self, drives: bool = True, **config: object) -> None:
        self.now_ms = 0
        self.has_scans = self.has_odometry = True
        self.subscribers = 1
        self.publishers = ["robot"]
        self.began, self.off = BEGAN, Pose()
        self.lines: list[str] = []
        self.sent: list[tuple[int, Command]] = []
        self.asked: list[tuple[Tick | None, Pose, int]] = []
        self.last: Tick | None = None
        reader = MessageReader()
        self.pilot = AheadPilot(Forward(), Guard(preset(), 0.2))
        steering = Steering(self, lambda command: self.sent.append((self.now_ms, command)), lambda: self.subscribers)
        laser = LaserReader(reader, None, Pose(0.2, -0.3, 0.4))
        notices = Notices(self.lines.append)
        receive, now_ns = self._receive, lambda: self.now_ms * MS
        trace = Trace(preset(**config), None, 0.2)
        self.requests: list[Request] = []
        steers = steering if drives else None
        self.robot = LiveRobot(receive, reader, laser, notices, trace, steers, now_ns, lambda: taken(self.requests))
        self.slam = Slam(preset(front_end="scan-matching", estimator="isam2"))

    def ahead(self, motion: Pose, stamp_ns: int) -> Command:
        """In place of the pilot, which is asked."""
        self.asked.append((self.last, motion, stamp_ns))
        return self.pilot.ahead(motion, stamp_ns)

    @staticmethod
    def pose_at(ms: float) -> Pose:
        return Pose(2.0, 3.0, 0.7) @ Pose(0.5 * math.sin(4e-4 * ms), 0.5 * (1.0 - math.cos(4e-4 * ms)), 4e-4 * ms)

    def _receive(self, timeout_s: float):
        self.now_ms += 20
        stamp_ns = self.began + self.now_ms * MS
        found = []
        if self.has_odometry:
            odometry = MAKE.odometry(stamp_ns, self.off @ self.pose_at(self.now_ms))
            odometry.header.frame_id = "wheels"
            for name in self.publishers:
                found.append((False, MAKE.serialized(odometry, ODOMETRY), name))
        if self.has_scans and self.now_ms % 100 == 0:
            ranges = np.full(360, 3.0, dtype=np.float32)
            lag = np.float32(0.05 / 359)
            scan = Scan(ranges, np.float32(-np.pi), np.float32(2 * np.pi / 360), 10.0, time_increment=lag)
            found.append((True, MAKE.serialized(MAKE.scan(stamp_ns - 50 * MS, scan), LASER_SCAN), "robot"))
        return [(is_scan, Message(data, name)) for is_scan, data, name in found]

    def run(self, until_ms: int) -> None:
        """Run the loop; the clock is looked at after each tick."""
        while self.now_ms < until_ms:
            tick = self.robot.step(Command())
            assert tick is not None
            self.last = tick
            self.pilot.steer(self.slam.take(tick))

    def turn(self, until_ms: int) -> None:
        """Take what arrives, but wait for no tick: none follows without odometry."""
        while self.now_ms < until_ms:
            self.robot._turn()

    def commands(self, since_ms: int) -> set[Command]:
        return {command for ms, command in self.sent if ms > since_ms}


@pytest.fixture
def bench():
    found = Bench()
    yield found
    found.slam.close()


FORWARD = Command(0.2, 0.0)


def test_a_robot_is_steered_once_by_each_odometry_from_where_the_last_tick_was(bench):
    bench.run(2000)
    assert bench.commands(200) == {FORWARD} and not bench.lines and bench.robot.odom_frame == "wheels"
    stamps = [stamp_ns for *_, stamp_ns in bench.asked]
    assert stamps == sorted(set(stamps)) and max(np.diff(stamps)) <= 40 * MS
    for last, motion, stamp_ns in bench.asked:
        assert last is not None and 0 < stamp_ns - last.stamp_ns <= 100 * MS
        expected = last.odometry.inverse() @ bench.pose_at((stamp_ns - BEGAN) / MS)
        assert motion.array() == pytest.approx(expected.array(), abs=1e-5)


@pytest.mark.parametrize(("sensor", "name"), [("has_scans", "laser"), ("has_odometry", "odometry")])
def test_a_sensor_that_is_silent_for_400_ms_stops_the_robot_and_a_shorter_pause_does_not(bench, sensor, name):
    bench.run(1000)
    setattr(bench, sensor, False)
    bench.turn(1380)
    setattr(bench, sensor, True)
    bench.run(2000)
    assert bench.commands(200) == {FORWARD}
    bench.lines.clear()
    setattr(bench, sensor, False)
    last_ms = bench.now_ms - bench.now_ms % (100 if name == "laser" else 20)
    bench.turn(2600)
    assert bench.lines == [f"{name} is silent; the robot is stopped"] and bench.sent[-1][1] == Command()
    assert min(ms for ms, command in bench.sent if command == Command() and ms > 200) == last_ms + 420
    assert bench.commands(last_ms + 400) == {Command()}
    setattr(bench, sensor, True)
    bench.run(3000)
    assert bench.lines[1].startswith(f"{name} sends again, after 0.") and bench.sent[-1][1] == FORWARD


def test_a_robot_that_is_listened_to_is_silent_after_two_seconds():
    bench = Bench(drives=False)
    bench.run(1000)
    bench.has_scans = False
    bench.turn(3000)
    assert not bench.lines
    bench.turn(3040)
    assert bench.lines == ["laser is silent"]
    bench.slam.close()


def test_without_odometry_the_laser_alone_is_waited_for_and_the_robot_stands_at_each_scan():
    bench, ticks = Bench(drives=False, no_odometry=True), []
    bench.has_odometry = False
    while bench.now_ms < 4000:
        ticks.append(bench.robot.step(Command()))
    stamps_ms = [(tick.stamp_ns - BEGAN) / MS for tick in ticks if tick.scan is not None]
    assert stamps_ms == pytest.approx(range(100, 4001, 100), abs=1e-5)
    assert not bench.lines and {tick.odometry for tick in ticks} == {Pose()}
    bench.slam.close()


def test_a_second_publisher_stops_the_robot_and_ends_the_run(bench):
    bench.run(1000)
    bench.publishers = ["robot", "other"]
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 1200
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command()
    assert bench.lines == ["odometry: a second publisher sends beside the first; the robot is stopped"]
    bench.turn(1400)
    assert bench.commands(1040) == {Command()}


def test_a_publisher_that_takes_the_place_of_another_is_used_once_the_first_is_silent(bench):
    bench.run(1000)
    bench.publishers, bench.off = ["again"], Pose(5.0, -4.0, 2.0)
    bench.run(2000)
    assert bench.robot.outcome is None and bench.sent[-1][1] == FORWARD
    why = "after 0.4 s, its driver was started again; the robot is taken to stand where it was"
    assert any(line.startswith("odometry has jumped by ") and line.endswith(why) for line in bench.lines)


def test_odometry_that_jumps_within_a_moment_leaves_the_robot_where_it_was(bench):
    bench.run(1000)
    bench.off = Pose(5.0, -4.0, 2.0)
    bench.run(1500)
    (line,) = bench.lines
    assert line.endswith("faster than `robot.speed` and `robot.turn_rate`; the robot is taken to stand where it was")
    assert bench.commands(200) == {FORWARD}


def test_a_clock_that_jumps_is_told(bench):
    bench.run(1000)
    bench.began -= 3_600_000 * MS
    bench.run(2000)
    assert "the robot's clock has jumped; the map goes on" in bench.lines
    assert bench.robot.joiner.clock.jumps == 1


def test_a_second_subscriber_of_the_commands_stops_the_robot_and_ends_the_run_if_it_stays(bench):
    bench.run(1000)
    bench.subscribers = 2
    bench.run(12_900)
    assert bench.commands(1100) == {Command()} and bench.robot.outcome is None
    bench.subscribers = 1
    bench.run(13_500)
    assert bench.sent[-1][1] == FORWARD
    bench.subscribers = 2
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 26_000
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command() and bench.now_ms > 25_500


def test_the_source_keeps_nothing_of_what_has_passed(bench):
    """What grows with time is the record, and the map with the way driven; clocks are compared for half a minute."""

    def memory_after(until_ms: int) -> int:
        while bench.now_ms < until_ms:
            bench.robot.step(Command())
        for thread in threading.enumerate():  # one compares the clocks
            if thread.name == "clocks":
                thread.join(20.0)
        bench.robot.step(Command())
        bench.sent.clear()
        bench.asked.clear()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    gc.collect()  # what is taken from Python's free lists is not traced; they are empty now
    tracemalloc.start()
    try:
        before = memory_after(32_000)
        assert memory_after(67_000) - before < 50_000
    finally:
        tracemalloc.stop()


# --- odometry that begins anew elsewhere: the robot is searched in the map so far


class Driver:
    """Drives a circle, is switched off after a while, and started again 7 s later, with the robot at a place."""

    def __init__(self, place: Pose | None, T_anew_world: Pose, off_ms: int = 12_000) -> None:
        """`place` is None where the robot stands; odometry then begins in another frame."""
        self.now_ms, self.off_ms = 0, off_ms
        self.place, self.T_anew_world = place, T_anew_world
        self.name = "driver"
        self.requests: dict[int, Request] = {}
        """by the time from which they are there, ms"""
        self.sent: dict[int, Pose] = {}
        """odometry by stamp"""
        self.odom_in_map: dict[int, Pose] = {}
        """what is published, by the stamp of the scan"""
        self.world = self._at(START)
        self.truths: dict[int, Pose] = {}

    def _at(self, place: Pose) -> World:
        return World(WALLS, place, 0.2, CONFIG, np.random.default_rng(0))

    def receive(self, timeout_s: float) -> list[tuple[bool, Message]]:
        if self.now_ms == self.off_ms:
            self.now_ms += PAUSE_MS
            last = self.truths[max(self.truths)]
            self.world, self.name = self._at(self.place or last), "driver again"
        self.now_ms += 20
        tick = self.world.step(Command(0.4, 0.4))
        assert tick is not None and tick.truth is not None
        stamp_ns = BEGAN + self.now_ms * MS
        self.truths[stamp_ns] = tick.truth
        pose = tick.odometry if self.name == "driver" else self.T_anew_world @ tick.odometry
        self.sent[stamp_ns] = pose
        found = [(False, MAKE.serialized(MAKE.odometry(stamp_ns, pose), ODOMETRY))]
        if tick.scan is not None:
            found.append((True, MAKE.serialized(MAKE.scan(stamp_ns, tick.scan), LASER_SCAN)))
        return [(is_scan, Message(data, self.name)) for is_scan, data in found]

    def due(self) -> list[Request]:
        return [self.requests.pop(ms) for ms in sorted(self.requests) if ms <= self.now_ms]


def run(
    driver: Driver,
    max_time_s: float,
    steering: Callable[[Guard], Steering] | None = None,
    T_map_odom: Pose = T_MAP_ODOM,
) -> tuple[Trace, LiveRobot, list[str]]:
    config, lines = merge(CONFIG, {"max_time": max_time_s}), []
    trace, reader, guard = Trace(config, None, 0.2), MessageReader(), Guard(config, 0.2)
    laser, notices = LaserReader(reader, CONFIG.laser.max_range, Pose()), Notices(lines.append)
    steers = None if steering is None else steering(guard)
    robot = LiveRobot(driver.receive, reader, laser, notices, trace, steers, lambda: driver.now_ms * MS, driver.due)
    start = robot.begin()
    assert start is not None

    def odom_in_map(tick: Tick, trace: Trace) -> None:
        if tick.scan is not None:
            driver.odom_in_map[tick.stamp_ns] = robot.odom_in_map(tick, Pose.from_array(trace.estimates[-1]))

    recorded_drive(robot, T_map_odom @ start, Pilot(Navigator(), guard), trace, odom_in_map)
    return trace, robot, lines


def errors_m(trace: Trace, driver: Driver) -> np.ndarray:
    """Of the scans since the pause."""
    after = [k for k, stamp in enumerate(trace.stamps_ns) if stamp > BEGAN + driver.off_ms * MS]
    truths = np.array([(T_MAP_ODOM @ driver.truths[trace.stamps_ns[k]]).position for k in after])
    return np.linalg.norm(np.array([trace.estimates[k][:2] for k in after]) - truths, axis=1)


@pytest.mark.parametrize(
    ("place", "T_anew_world", "lost_s"),
    [
        (None, Pose(40.0, -7.0, 1.0), 0.2),  # a driver that begins at another pose
        (ELSEWHERE, Pose(), 0.2),  # odometry of one frame, as where the driver keeps it
        (ELSEWHERE, Pose(40.0, -7.0, 1.0), 12.0),  # carried: nothing says where
    ],
)
def test_a_robot_that_is_started_again_is_found_in_the_map(place, T_anew_world, lost_s):
    driver = Driver(place, T_anew_world)
    trace, robot, lines = run(driver, 24.0 + lost_s)
    assert trace.outcome == "log ended" and robot.outcome is None
    assert lines[0].endswith("its driver was started again; the pose is unknown and searched in the map")
    assert lines[-1] == "the robot's place in the map is found; the map goes on"
    anew_ns = BEGAN + (driver.off_ms + PAUSE_MS) * MS
    found_ns = min(stamp for stamp in trace.stamps_ns if stamp > anew_ns)
    assert found_ns - anew_ns <= (lost_s + 0.2) * 1e9
    errors = errors_m(trace, driver)
    assert errors.max() < 0.3 and errors[-1] < 0.03  # as uncertain as is said, until a loop is closed
    assert len(trace.carried_scans()) == 1


def test_the_tick_of_a_place_that_was_found_is_known_to_decimetres_and_has_no_scan():
    scan = Scan(np.array([2.5, 3.5], np.float32), np.float32(-0.7), np.float32(0.3), 9.0)
    T, tick = Pose(1.5, -0.7, 0.8), Tick(7, Pose(0.3, 0.4, 0.5), scan)
    found = placed(tick, T)
    assert (found.stamp_ns, found.odometry, found.scan) == (7, T @ tick.odometry, None)
    assert found.increment_cov == pytest.approx(np.diag([0.09, 0.09, 0.01]))


def test_a_driven_robot_that_is_elsewhere_stands_and_the_run_ends():
    driver, sent = Driver(ELSEWHERE, Pose(40.0, -7.0, 1.0)), []

    def steering(guard: Guard) -> Steering:
        return Steering(AheadPilot(Navigator(), guard), sent.append, lambda: 1)

    trace, robot, lines = run(driver, 45.0, steering)
    assert robot.outcome == "lost" and sent[-1] == Command()
    assert lines[-1] == "the robot's place in the map is not found; the robot is stopped"
    assert trace.stamps_ns[-1] <= BEGAN + driver.off_ms * MS


# --- what a user asks of a run

COV = np.array([[0.36, 0.05, 0.0], [0.05, 0.16, 0.01], [0.0, 0.01, 0.05]])
NEVER_MS = 10**6


def test_a_pose_that_is_set_is_that_of_the_robot_from_then_on_as_uncertain_as_it_is_said_to_be():
    driver, wanted = Driver(None, Pose(), NEVER_MS), Pose(-3.0, 5.0, 2.2)
    driver.requests[4400] = SetPose(wanted, COV)
    trace, _, lines = run(driver, 5.4)
    asked_ns = BEGAN + 4400 * MS
    assert lines[0] == "the pose is set to -3.00 m, 5.00 m, 126°"
    after = [k for k, stamp in enumerate(trace.stamps_ns) if stamp > asked_ns]
    assert len(after) > 5 and trace.stamps_ns[after[0]] <= asked_ns + 300 * MS
    for k in after:
        expected = wanted @ driver.truths[asked_ns].inverse() @ driver.truths[trace.stamps_ns[k]]
        found = Pose.from_array(trace.estimates[k])
        assert found.position == pytest.approx(expected.position, abs=0.02)
        published = driver.odom_in_map[trace.stamps_ns[k]] @ driver.sent[trace.stamps_ns[k]]
        assert published.position == pytest.approx(found.position, abs=1e-6)
    key = trace.key_estimates[trace.last_key[after[0]]]
    assert key.pose_cov[:2, :2] == pytest.approx(COV[:2, :2], abs=0.02)
    assert key.pose_cov[2, 2] == pytest.approx(0.05, abs=0.003)
    assert trace.carried_scans() == [after[0]]


def test_a_map_begins_where_the_robot_is_said_to_be_before_the_first_scan():
    driver, wanted = Driver(None, Pose(), NEVER_MS), Pose(-3.0, 5.0, 2.2)
    driver.requests[0] = SetPose(wanted, COV)
    trace, _, lines = run(driver, 1.0, T_map_odom=Pose())
    assert lines == ["the pose is set to -3.00 m, 5.00 m, 126°"] and not trace.carried_scans()
    first_ns = trace.stamps_ns[0]
    expected = wanted @ driver.truths[BEGAN + 20 * MS].inverse() @ driver.truths[first_ns]
    assert trace.estimates[0] == pytest.approx(expected.array(), abs=0.01)
    assert (driver.odom_in_map[first_ns] @ driver.sent[first_ns]).array() == pytest.approx(trace.estimates[0])


def test_a_paused_run_takes_no_scans_and_goes_on_where_the_robot_has_driven_meanwhile():
    driver = Driver(None, Pose(), NEVER_MS)
    driver.requests |= {3000: Pause(True), 8000: Pause(False)}
    trace, robot, lines = run(driver, 10.0)
    seconds = (np.array(trace.stamps_ns) - BEGAN) * 1e-9
    assert lines == ["paused: scans are left out", "the pause is over; the map goes on"]
    assert not np.any((seconds > 3.1) & (seconds < 8.0)) and np.count_nonzero(seconds > 8.0) > 10
    assert robot.joiner.dropped.total() == 0
    driver.off_ms = 8000
    assert errors_m(trace, driver).max() < 0.03 and not trace.carried_scans()


def test_a_driven_robot_stands_while_the_run_is_paused_and_until_it_has_seen_where_it_was_set_to(bench):
    bench.run(1000)
    bench.requests.append(Pause(True))
    bench.run(2000)
    assert bench.commands(1060) == {Command()}
    bench.requests.append(Pause(False))
    bench.run(3000)
    assert bench.sent[-1][1] == FORWARD
    bench.robot._T_odom_map = Pose(3.0, 4.0, 0.5)
    bench.requests.append(SetPose(Pose(1.0, 2.0, 0.3), COV))
    bench.run(3300)
    stood_ms = [ms for ms, command in bench.sent if ms > 3000 and command == Command()]
    assert stood_ms and max(stood_ms) - 3000 <= 240
    assert bench.sent[-1][1] == FORWARD


def test_a_reset_ends_a_run_that_has_a_map_and_stops_the_robot(bench):
    bench.requests.append(Reset())
    bench.run(1000)
    assert bench.robot.outcome is None and bench.sent[-1][1] == FORWARD
    bench.robot._T_odom_map = Pose(3.0, 4.0, 0.5)
    bench.requests.append(Reset())
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 1100
    assert bench.robot.outcome == "reset" and bench.sent[-1][1] == Command()
    assert bench.lines == ["a new map is asked for; the robot is stopped"]
