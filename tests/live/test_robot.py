"""A live robot without a network and without a clock: what it makes of messages, when it stops, and how it is found."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.live.reading import Notices, RobotPose
from sixthsense.live.robot import AheadPilot, LiveRobot, Received, Steering
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.slam.slam import Slam

MS = 1_000_000
BEGAN = 1_700_000_000_000 * MS


class Forward(Navigator):
    """Drives forward always."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.2, 0.0)


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
        self.robot = LiveRobot(self._receive, notices, preset(), steers, now_ns=lambda: self.now_ms * MS)
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
def bench() -> Iterator[Bench]:
    found = Bench()
    yield found
    found.slam.close()


@pytest.fixture
def listening() -> Iterator[Bench]:
    found = Bench(drives=False)
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
    assert bench.lines[1] == f"{name} sends again" and bench.sent[-1][1] == FORWARD


def test_a_robot_that_is_listened_to_is_silent_after_two_seconds(listening):
    listening.run(1000)
    listening.has_scans = False
    listening.turn(3000)
    assert not listening.lines
    listening.turn(3040)
    assert listening.lines == ["laser is silent"]


def test_a_second_publisher_stops_the_robot_and_ends_the_run(bench):
    bench.run(1000)
    bench.publishers = ["robot", "other"]
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 1200
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command()
    assert bench.lines == ["odometry: a second publisher sends beside the first; the robot is stopped"]
    bench.turn(1400)
    assert bench.commands(1020) == {Command()}


def test_odometry_that_jumps_goes_on_from_where_it_was_where_a_robot_is_listened_to(listening):
    listening.run(1000)
    listening.off = Pose(5.0, -4.0, 2.0)
    listening.run(1500)
    (line,) = listening.lines
    assert line.startswith("odometry has jumped by ") and line.endswith("is assumed to stand where it was")
    tick = listening.last
    expected = listening.pose_at((tick.stamp_ns - BEGAN) / MS)
    assert tick.odometry.array() == pytest.approx(expected.array(), abs=0.02)
    T_map_robot, sent = Pose(1.0, 2.0, 0.5), listening.off @ expected  # what the robot's own odometry is in the map
    found = listening.robot.odom_in_map(tick, T_map_robot) @ sent
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
