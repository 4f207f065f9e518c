"""A live robot without a network and without a clock: what it makes of messages, when it stops, and how it steers."""

import itertools
import math
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest

from sixthsense.config import RobotConfig, preset
from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Command, Tick
from sixthsense.live.reading import Notices, RobotPose
from sixthsense.live.robot import AheadPilot, LiveRobot, Received, ScanJoiner, Steering
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import TURN_RATE, Pilot
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam

MS = 1_000_000
BEGAN = 1_700_000_000_000 * MS
CONFIG = preset(seed=2)
HALL = np.array(
    [[[-1, -2], [6, -2]], [[6, -2], [6, 2]], [[6, 2], [-1, 2]], [[-1, 2], [-1, -2]], [[2, -2], [2, -0.5]]], dtype=float
)


class Forward(Navigator):
    """Drives forward always."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.2, 0.0)


def to_goal() -> Navigator:
    rng = np.random.default_rng(0)
    config = CONFIG.replaced(task="goal")
    return make_navigator(config, Pose(), np.array([[4.0, -1.0]]), (0.0, 0.0, 1.0, 1.0), 0.2, rng, rng)


def test_commands_ahead_of_the_last_scan_are_those_of_a_pilot_that_takes_every_tick():
    """Slam of the one takes odometry at once, that of the other only with the next scan."""
    world = World(HALL, Pose(), 0.2, CONFIG, np.random.default_rng(0))
    punctual = Pilot(to_goal(), Guard(CONFIG, 0.2))
    ahead = AheadPilot(to_goal(), Guard(CONFIG, 0.2))
    command, other, held = Command(), Command(), []
    moved = 0
    with Slam(CONFIG) as slam, Slam(CONFIG) as late_slam:
        for _ in range(600):
            tick = world.step(command)
            assert tick is not None
            command = punctual.steer(slam.take(tick))
            held.append(tick)
            if tick.scan is not None:
                for old in held:
                    in_force = ahead.steer(late_slam.take(old))
                    assert in_force == other
                held = []
                last = tick
            other = ahead.ahead(last.odometry.inverse() @ tick.odometry, tick.stamp_ns)
            assert (other.speed, other.turn_rate) == pytest.approx((command.speed, command.turn_rate), abs=1e-6)
            moved += command != Command()
    assert moved > 300


def test_a_late_scan_leaves_earlier_returns_where_they_are():
    """Scans are older than the newest odometry: the guard goes back to where they were taken."""
    guard = Guard(CONFIG, 0.2)
    pilot = AheadPilot(Forward(), guard)
    start, step = Pose(0.5, 1.4, 0.05), Pose(0.1, 0.0, -0.03)
    world = World(HALL, start, 0.2, CONFIG, np.random.default_rng(0))
    first = world.step(Command())
    assert first is not None and first.scan is not None
    with Slam(CONFIG, start) as slam:
        pilot.steer(slam.take(first))
        at = first.odometry
        for k in range(1, 5):
            at = at @ step
            late = step @ step @ step  # odometry is three steps ahead of the scan
            pilot.ahead(step @ late, k)
            scan = Scan.from_config(
                cast_rays(start @ first.odometry.inverse() @ at, beam_bearings(CONFIG.laser), HALL, 9.0), CONFIG.laser
            )
            pilot.steer(slam.take(Tick(first.stamp_ns + 10**8 * k, at, scan)))
            pilot.ahead(late, k)
        obstacles = guard.obstacles()
    T_world_guard = start @ first.odometry.inverse() @ at @ late @ Pose(*guard._at).inverse()
    far_m = [point_segment_distance(point, HALL).min() for point in T_world_guard @ obstacles.earlier]
    assert len(far_m) > 50 and max(far_m) < 0.06


def test_the_guard_knows_the_motion_since_the_scan_even_if_no_step_has_brought_it():
    pilot = AheadPilot(Forward(), Guard(CONFIG, 0.2))
    assert pilot.ahead(Pose(1.0, 0.0, 0.0), 0) == Command()  # before the first step
    tick = World(np.array([[[2.0, -1.0], [2.0, 1.0]]]), Pose(), 0.2, CONFIG, np.random.default_rng(0)).step(Command())
    with Slam(CONFIG) as slam:
        pilot.steer(slam.take(tick))
    assert [pilot.ahead(Pose(x, 0.0, 0.0), k).speed for k, x in enumerate((0.0, 1.85))] == [0.2, 0.0]
    for pace, command in ((0.5, Command(0.1, 0.0)), (0.0, Command(0.0, TURN_RATE))):
        pilot.pace = pace
        assert pilot.ahead(Pose(), 99) == command  # and knows when the robot is back


def pose_at(ms: float) -> Pose:
    """On an arc, from rest at 0 ms."""
    return Pose(math.sin(0.001 * ms), 1.0 - math.cos(0.001 * ms), 0.001 * ms)


class Driver:
    """Feeds a joiner; times are milliseconds from the beginning, of stamp and of arrival."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.joiner = ScanJoiner(RobotConfig(), lambda why: self.dropped.update([why]))
        self.ticks: list[Tick] = []

    def odometry(self, *stamps_ms: int, arrival_ms: int | None = None) -> "Driver":
        for ms in stamps_ms:
            arrival = ms if arrival_ms is None else arrival_ms
            self.joiner.add_odometry(BEGAN + ms * MS, pose_at(ms), arrival * MS)
            self.at(arrival)
        return self

    def scan(self, stamp_ms: int, arrival_ms: int | None = None) -> "Driver":
        arrival = stamp_ms if arrival_ms is None else arrival_ms
        scan = Scan(np.full(5, 2.0, dtype=np.float32), np.float32(-1.0), np.float32(0.5), 10.0)
        self.joiner.add_scan(BEGAN + stamp_ms * MS, scan, arrival * MS)
        return self.at(arrival)

    def at(self, arrival_ms: int) -> "Driver":
        self.ticks += self.joiner.ticks(arrival_ms * MS)
        return self

    @property
    def scans_ms(self) -> list[float]:
        return [(tick.stamp_ns - BEGAN) / MS for tick in self.ticks if tick.scan is not None]


LOST = {"scan without odometry": 1}


@pytest.mark.parametrize(("feed", "scans_ms", "dropped"), [
    (lambda d: d.odometry(0).scan(30).at(230).odometry(40, arrival_ms=230), [30], {}),
    (lambda d: d.odometry(0).scan(30).at(231).odometry(40, arrival_ms=231), [], LOST),
    (lambda d: d.odometry(20).scan(400).odometry(520), [400], {}),
    (lambda d: d.odometry(20).scan(400).odometry(540), [], LOST),  # a longer gap, in which nothing is interpolated
    (lambda d: d.odometry(*range(20, 1520, 20)).scan(510, 1500).scan(470, 1500).scan(510, 1500), [510],
     {"scan twice or late": 2}),
    (lambda d: d.scan(90).odometry(40, 60, 80, 100, 40, 100), [90], {"odometry twice or out of order": 2}),
])  # fmt: skip
def test_a_scan_waits_200_ms_for_the_odometry_after_it_and_each_message_is_used_once(feed, scans_ms, dropped):
    driver = feed(Driver())
    assert (driver.scans_ms, driver.dropped) == (scans_ms, dropped)


def test_a_tick_has_the_pose_of_its_stamp_after_the_odometry_before_it():
    driver = Driver().odometry(20, 40).scan(50).odometry(60, 80).scan(80)
    assert [(tick.stamp_ns - BEGAN) // MS for tick in driver.ticks] == [20, 40, 50, 60, 80]
    for tick in driver.ticks:
        expected = pose_at((tick.stamp_ns - BEGAN) / MS)
        assert tick.odometry.array() == pytest.approx(expected.array(), abs=1e-4)
    assert driver.joiner.now(95 * MS) == BEGAN + 95 * MS


@pytest.mark.parametrize(("pause_s", "off", "is_anew"), [
    (7.0, Pose(0.0, 4.6), False), (7.0, Pose(0.0, 4.8), True), (7.0, Pose(-4.8), True), (0.02, Pose(0.3, -0.3), False),
    (0.02, Pose(0.4, -0.4), True), (0.02, Pose(theta=-0.5), False), (0.02, Pose(theta=0.55), True),
])  # fmt: skip
def test_odometry_that_moves_or_turns_faster_than_the_robot_can_has_begun_anew(pause_s, off, is_anew):
    joiner, before = ScanJoiner(RobotConfig(speed=0.5, turn_rate=0.8), print), Pose(2.0, 3.0, -3.1)
    after = Pose(before.x + off.x, before.y + off.y, before.theta + off.theta)
    assert joiner.add_odometry(BEGAN, before, BEGAN) == ""
    stamp_ns = BEGAN + round(pause_s * 1e9)
    assert bool(joiner.add_odometry(stamp_ns, after, stamp_ns)) == is_anew


@pytest.mark.parametrize("seed", range(5))
def test_whatever_the_network_does_each_scan_is_used_once_or_dropped_and_ticks_ascend(seed):
    rng, driver, sent = np.random.default_rng(seed), Driver(), 0
    arrivals: list[tuple[int, bool, int]] = []
    for ms in range(0, 20_000, 20):
        arrivals.append((ms + int(rng.integers(0, 10)), False, ms))
        if ms % 100 == 0:
            delay = int(rng.integers(0, 500)) if rng.random() < 0.2 else int(rng.integers(0, 10))
            copies = 0 if rng.random() < 0.05 else 1 + (rng.random() < 0.05)
            sent += copies
            arrivals += [(ms + delay + k, True, ms) for k in range(copies)]
    for arrival, is_scan, ms in sorted(arrivals):
        (driver.scan if is_scan else driver.odometry)(ms, arrival_ms=arrival)
    driver.at(30_000)
    assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(driver.ticks))
    of_scans = sum(count for kind, count in driver.dropped.items() if kind.startswith("scan"))
    assert len(driver.scans_ms) + of_scans == sent and len(driver.scans_ms) > 0.7 * sent


class Bench:
    """A robot on an arc, and whose sensors can be switched off; time passes while it waits."""

    def __init__(self, drives: bool = True) -> None:
        self.now_ms = 0
        self.has_scans = self.has_odometry = True
        self.subscribers = 1
        self.publishers = ["robot"]
        self.began, self.off = BEGAN, Pose()
        self.lines: list[str] = []
        self.sent: list[tuple[int, Command]] = []
        self.asked: list[tuple[Tick | None, Pose, int]] = []
        self.last: Tick | None = None
        self.pilot = AheadPilot(Forward(), Guard(preset(), 0.2))
        steering = Steering(self, lambda command: self.sent.append((self.now_ms, command)), lambda: self.subscribers)
        notices, steers = Notices(self.lines.append), steering if drives else None
        start = None if drives else Pose(-3.0, 5.0, 2.2)
        self.robot = LiveRobot(self._receive, notices, preset(), steers, start, lambda: self.now_ms * MS)
        self.slam = Slam(preset(front_end="scan-matching", estimator="isam2"))

    def ahead(self, motion: Pose, stamp_ns: int) -> Command:
        """In place of the pilot, which is asked."""
        self.asked.append((self.last, motion, stamp_ns))
        return self.pilot.ahead(motion, stamp_ns)

    @staticmethod
    def pose_at(ms: float) -> Pose:
        return Pose(2.0, 3.0, 0.7) @ Pose(0.5 * math.sin(4e-4 * ms), 0.5 * (1.0 - math.cos(4e-4 * ms)), 4e-4 * ms)

    def _receive(self, timeout_s: float) -> Iterator[Received]:
        self.now_ms += 20
        stamp_ns = self.began + self.now_ms * MS
        if self.has_odometry:
            for name in self.publishers:
                yield name, RobotPose(stamp_ns, self.off @ self.pose_at(self.now_ms), "wheels", "base")
        if self.has_scans and self.now_ms % 100 == 0:
            ranges, lag = np.full(360, 3.0, dtype=np.float32), np.float32(0.05 / 359)
            scan = Scan(ranges, np.float32(-np.pi), np.float32(2 * np.pi / 360), 10.0, time_increment=lag)
            yield "robot", (stamp_ns - 50 * MS, scan)

    def run(self, until_ms: int) -> None:
        """Run the loop; the clock is looked at after each tick."""
        while self.now_ms < until_ms:
            tick = self.robot.step(Command())
            assert tick is not None
            self.last = tick
            self.pilot.steer(self.slam.take(tick))

    def turn(self, until_ms: int) -> None:
        """Take what arrives, but wait for no tick: none follows without scans."""
        while self.now_ms < until_ms:
            self.robot._turn()

    def commands(self, since_ms: int) -> set[Command]:
        return {command for ms, command in self.sent if ms > since_ms}


@pytest.fixture
def bench(request) -> Iterator[Bench]:
    found = Bench(drives=getattr(request, "param", True))
    yield found
    found.slam.close()


is_listened_to = pytest.mark.parametrize("bench", [False], indirect=True)
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
    bench.publishers = ["robot" if name == "laser" else "another in its place"]
    bench.run(3000)
    assert bench.lines[1] == f"{name} sends again" and bench.sent[-1][1] == FORWARD


@is_listened_to
def test_a_robot_that_is_listened_to_is_silent_after_two_seconds_and_a_run_waits_no_longer_than_it_is_to_last(bench):
    bench.run(1000)
    bench.has_scans = False
    bench.turn(3000)
    assert not bench.lines
    bench.turn(3040)
    bench.robot._due.clear()
    assert bench.lines == ["laser is silent"] and bench.robot.begin(1.0) is None and 4000 < bench.now_ms < 4100


def test_a_second_publisher_stops_the_robot_and_ends_the_run(bench):
    bench.run(1000)
    bench.publishers = ["robot", "other"]
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 1200
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command()
    assert bench.lines == ["odometry: a second publisher sends beside the first; the robot is stopped"]
    bench.turn(1400)
    assert bench.commands(1020) == {Command()}


@is_listened_to
def test_odometry_that_jumps_twice_goes_on_from_where_it_was_where_a_robot_is_listened_to(bench):
    for off in (Pose(), Pose(5.0, -4.0, 2.0), Pose(-1.0, 9.0, -2.5)):
        bench.off = off
        bench.run(bench.now_ms + 700)
    assert bench.lines[0].startswith("odometry has jumped by ") and len(bench.lines) == 1  # once in 10 s
    assert bench.lines[0].endswith("is assumed to stand where it was")
    tick = bench.last
    moved = bench.pose_at(20).inverse() @ bench.pose_at((tick.stamp_ns - BEGAN) / MS)
    assert tick.odometry.array() == pytest.approx((Pose(-3.0, 5.0, 2.2) @ moved).array(), abs=0.03)  # the first one
    T_map_robot, sent = Pose(1.0, 2.0, 0.5), off @ bench.pose_at((tick.stamp_ns - BEGAN) / MS)
    found = bench.robot.odom_in_map(tick, T_map_robot) @ sent  # what the robot's own odometry is in the map
    assert found.array() == pytest.approx(T_map_robot.array(), abs=0.02)


@pytest.mark.parametrize("pause_ms", [0, 800])
def test_a_driven_robot_stands_after_a_jump_of_the_odometry_and_the_run_ends(bench, pause_ms):
    bench.run(1000)
    bench.has_odometry = not pause_ms
    bench.turn(1000 + pause_ms)
    bench.has_odometry, bench.off = True, Pose(5.0, -4.0, 2.0)
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 2200
    assert bench.robot.outcome == "lost" and bench.sent[-1][1] == Command()
    assert any(line.startswith("odometry has jumped by ") and "robot is stopped" in line for line in bench.lines)


def test_a_robot_whose_clock_has_gone_back_is_silent_until_it_has_caught_up(bench):
    bench.run(1000)
    bench.began -= 1000 * MS
    bench.turn(1900)
    silent = {f"{name} is silent; the robot is stopped" for name in ("laser", "odometry")}
    assert {line for line in bench.lines if "dropped" not in line} == silent and bench.sent[-1][1] == Command()
    assert bench.sent[-1][0] <= 1440
    bench.run(2500)
    assert bench.robot.outcome is None and bench.sent[-1][1] == FORWARD


def test_a_driven_robot_stands_while_another_subscriber_of_its_commands_is_there(bench):
    bench.run(1000)
    bench.subscribers = 2
    bench.run(2000)
    assert bench.commands(1100) == {Command()} and "second subscriber" in bench.lines[-1]
    bench.subscribers = 1
    bench.run(2500)
    assert bench.sent[-1][1] == FORWARD and bench.robot.outcome is None
