"""A live robot without a network and without a clock: what it makes of messages, and when it stops."""

import gc
import tracemalloc

import numpy as np
import pytest

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.live.joining import SILENT_NS
from sixthsense.live.network import Message
from sixthsense.live.reading import LaserReader, MessageReader, Notices
from sixthsense.live.robot import LiveRobot, Steering
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import AheadPilot, Pilot
from sixthsense.record.messages import Messages
from sixthsense.record.trace import Trace
from sixthsense.slam.slam import Slam
from sixthsense.sources.logs.ros_messages import LASER_SCAN, ODOMETRY

MS = 1_000_000
BEGAN = 1_700_000_000_000 * MS
MAKE = Messages()


class Forward(Navigator):
    """Drives forward always."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.2, 0.0)


class Bench:
    """A robot that stands, and whose sensors can be switched off; time passes while it waits."""

    def __init__(self, config: Config | None = None) -> None:
        self.now_ms = 0
        self.has_scans = self.has_odometry = True
        self.odd: bytes | None = None
        self.jump_ms = 0
        self.subscribers = 1
        self.publishers = ["robot"]
        self.lines: list[str] = []
        self.sent: list[tuple[int, Command]] = []
        reader = MessageReader()
        self.pilot = AheadPilot(Pilot(Forward(), Guard(preset(), 0.2)))
        send = lambda command: self.sent.append((self.now_ms, command))  # noqa: E731
        steering = Steering(self.pilot, send, lambda: self.subscribers)
        laser = LaserReader(reader, None, Pose())
        notices = Notices(self.lines.append)
        trace = Trace(config or preset(), None, 0.2)
        self.robot = LiveRobot(self._receive, reader, laser, notices, trace, steering, lambda: self.now_ms * MS)
        self.slam = Slam(preset(front_end="scan-matching", estimator="isam2"))

    def _receive(self, timeout_s: float):
        self.now_ms += 20
        stamp_ns = BEGAN + (self.now_ms + self.jump_ms) * MS
        found = []
        if self.has_odometry:
            for name in self.publishers:
                found.append((False, MAKE.serialized(MAKE.odometry(stamp_ns, Pose(), None), ODOMETRY), name))
        if self.has_scans and self.now_ms % 100 == 0:
            ranges = np.full(360, 3.0, dtype=np.float32)
            scan = Scan(ranges, np.float32(-np.pi), np.float32(2 * np.pi / 360), 10.0)
            found.append((True, MAKE.serialized(MAKE.scan(stamp_ns, scan), LASER_SCAN), "robot"))
        if self.odd is not None:
            found.append((True, self.odd, "robot"))
        return [(is_scan, Message(data, name)) for is_scan, data, name in found]

    def run(self, until_ms: int) -> None:
        """Run the loop; the clock is looked at after each tick."""
        while self.now_ms < until_ms:
            tick = self.robot.step(Command())
            assert tick is not None
            self.pilot.steer(self.slam.take(tick))


@pytest.fixture
def bench():
    found = Bench()
    yield found
    found.slam.close()


@pytest.mark.parametrize("sensor", ["has_scans", "has_odometry"])
def test_a_sensor_that_stops_stops_the_robot_within_half_a_second(bench, sensor):
    bench.run(1000)
    setattr(bench, sensor, False)
    off_ms = bench.now_ms
    name = "laser" if sensor == "has_scans" else "odometry"
    said = f"{name} is silent; the robot is stopped"
    while said not in bench.lines:  # not by `step`, which waits for a tick: none follows without odometry
        bench.robot._turn()
        assert bench.now_ms < off_ms + 1000
    assert bench.sent[-1][1] == Command()
    stopped_ms = max(ms for ms, command in bench.sent if command != Command()) - off_ms
    assert stopped_ms <= 500 and SILENT_NS < 500 * MS


def test_a_second_publisher_stops_the_robot_and_ends_the_run(bench):
    bench.run(1000)
    bench.publishers = ["robot", "other"]
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 1200
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command()
    assert bench.lines == ["odometry: a second publisher sends beside the first; the robot is stopped"]
    sent = len(bench.sent)
    bench.robot._turn()
    assert not any(command != Command() for _, command in bench.sent[sent:])


def test_a_second_subscriber_of_the_commands_stops_the_robot_and_ends_the_run_if_it_stays(bench):
    bench.run(1000)
    bench.subscribers = 2
    bench.run(6000)
    assert not any(command != Command() for ms, command in bench.sent if ms > 1100)
    bench.subscribers = 1
    bench.run(7000)
    assert bench.sent[-1][1] == Command(0.2, 0.0) and bench.robot.outcome is None
    bench.subscribers = 2
    while bench.robot.step(Command()) is not None:
        assert bench.now_ms < 30_000
    assert bench.robot.outcome == "another robot" and bench.sent[-1][1] == Command()


def test_the_source_keeps_nothing_of_what_has_passed(bench):
    """What grows with time is the record, and the map with the way driven."""

    def memory_after(until_ms: int) -> int:
        while bench.now_ms < until_ms:
            bench.robot.step(Command())
        bench.sent.clear()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = memory_after(30_000)
        assert memory_after(120_000) - before < 100_000
    finally:
        tracemalloc.stop()
