"""A robot on the network as a `Source`: messages become ticks, and the robot is steered between them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import sweep_ns
from sixthsense.core.source import Command, Tick
from sixthsense.live.ahead_pilot import AheadPilot
from sixthsense.live.joining import LONG_SILENT_NS, SILENT_NS, OdometryJump, Publishers, ScanJoiner, SilenceDetector
from sixthsense.live.network import Message
from sixthsense.live.reading import LaserReader, MessageReader, Notices
from sixthsense.loop.interrupt import is_command_ended

ANOTHER_ROBOT, LOST = "another robot", "lost"
"""outcomes of a run that the robot itself ends"""

_NEAR_M = 0.25
"""A robot that can have driven no farther while it sent nothing is assumed to stand where it was."""
_WAIT_S = 0.02
_ANNOUNCED_NS = 12_000_000_000  # after which a killed program is not announced any more: 10 s, and some to notice it

Received = tuple[bool, Message]
"""whether a message is a scan, else odometry; and the message"""


class Steering(NamedTuple):
    """How a robot is driven."""

    pilot: AheadPilot
    send: Callable[[Command], object]
    subscribers: Callable[[], int]
    """how many programs read the commands"""


class LiveRobot:
    """A robot that sends scans and odometry, and executes commands if it is to be driven."""

    def __init__(
        self,
        receive: Callable[[float], Iterable[Received]],
        readers: tuple[MessageReader, LaserReader],
        notices: Notices,
        config: Config,
        steering: Steering | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        start: Callable[[], Pose | None] = lambda: None,
    ) -> None:
        """`receive(timeout_s)` waits for messages at most so long; `now_ns` is the time of their arrival.

        `start` gives the newest pose that a user has set since the last call, `T_map_robot`: before the first tick the
        map begins there.
        """
        self.joiner = ScanJoiner(config.robot)
        self.odom_frame = "odom"
        self.outcome: str | None = None
        """why the run ends, None as long as the robot can be used"""
        self._receive, self._start, self._now_ns = receive, start, now_ns
        self._reader, self._laser = readers
        self._notices, self._steering, self._has_no_odometry = notices, steering, config.no_odometry
        self._publishers = {is_scan: Publishers() for is_scan in (False, True)}
        self._shared_ns: int | None = None  # since when the commands have a second subscriber
        silent_ns = LONG_SILENT_NS if steering is None else SILENT_NS
        self._scans, self._odometry = (SilenceDetector(name, now_ns(), silent_ns) for name in ("laser", "odometry"))
        self._due: deque[Tick] = deque()
        self._last: Tick | None = None
        self._newest: tuple[int, Pose] | None = None  # odometry that the robot has not been steered by

    def step(self, command: Command) -> Tick | None:
        """Wait for the next tick; None when the run is to end. The robot is steered meanwhile."""
        self._last = self._due.popleft() if self._wait() else None
        return self._last

    def begin(self) -> Pose | None:
        """Wait for the first tick; the odometry of it, None when the run is to end."""
        return self._due[0].odometry if self._wait() else None

    def odom_in_map(self, tick: Tick, T_map_robot: Pose) -> Pose:
        """The frame of odometry in that of the map, by the robot's pose at a tick."""
        T_odom_robot = self.joiner.T_joined_odom.inverse() @ tick.odometry
        return T_map_robot @ T_odom_robot.inverse()

    def _wait(self) -> bool:
        """Wait for a tick; false when the run is to end."""
        while not self._due:
            if is_command_ended() or self.outcome is not None:
                return False
            self._turn()
        return True

    def _turn(self) -> None:
        """Read what has arrived, and steer by it."""
        self._read_messages()
        self._set_start()
        self._due += self.joiner.ticks(self._now_ns())
        self._check_silence()
        self._steer()

    def _read_messages(self) -> None:
        for is_scan, message in self._receive(_WAIT_S):
            arrival_ns = self._now_ns()
            sensor = self._scans if is_scan else self._odometry
            publisher = self._publishers[is_scan].heard(message.publisher, arrival_ns)
            if publisher == "second":
                self._end(ANOTHER_ROBOT, f"{sensor.name}: a second publisher sends beside the first")
                return
            if publisher == "unknown":
                continue
            try:
                self._read_scan(message.data, arrival_ns) if is_scan else self._read_odometry(message.data, arrival_ns)
            except ValueError as error:
                self._notices.unusable("scan" if is_scan else "odometry", error)
                continue
            if (silent_s := sensor.heard(arrival_ns)) is not None:
                self._say(f"{sensor.name} again", f"{sensor.name} sends again, after {silent_s:.1f} s")

    def _read_scan(self, data: bytes, arrival_ns: int) -> None:
        stamp_ns, scan = self._laser.scan(data)
        if self._has_no_odometry:  # it seems to stand, and moves as its scans show
            self.joiner.add_odometry(stamp_ns - sweep_ns(len(scan.ranges), scan.time_increment), Pose(), arrival_ns)
        self.joiner.add_scan(stamp_ns, scan, arrival_ns)

    def _read_odometry(self, data: bytes, arrival_ns: int) -> None:
        message = self._reader.odometry(data)
        jump = self.joiner.add_odometry(message.stamp_ns, message.T_odom_robot, arrival_ns)
        self.odom_frame, self._newest = message.frame or "odom", self.joiner.newest
        if self.joiner.clock.has_jumped:
            self._end(LOST, "the robot's clock has jumped")
        if jump is not None:
            self._end_if_lost(jump)

    def _end_if_lost(self, jump: OdometryJump) -> None:
        """End the run unless the robot stands where it was: after a short silence it cannot be far from there."""
        text = f"odometry has jumped by {jump.jump_m:.1f} m after {jump.pause_s:.1f} s"
        if jump.reach_m <= _NEAR_M or self._last is None:
            self._say("odometry jumped", f"{text}; the robot is assumed to stand where it was")
        else:
            self._end(LOST, f"{text}, faster than `robot.speed` and `robot.turn_rate`")

    def _set_start(self) -> None:
        """Let the map begin at the pose that the user has set; one that is set later is refused."""
        if self.joiner.newest is None or (T_map_robot := self._start()) is None:
            return
        if self._last is not None or self._due or self._steering is not None:
            self._say(
                "pose refused", "a pose is left out: before the first scan of a run that does not drive it is used"
            )
            return
        self.joiner.begin_at(T_map_robot)
        x, y, theta = T_map_robot.array()
        self._say("pose set", f"the map begins at {x:.2f} m, {y:.2f} m, {np.degrees(theta):.0f}°")

    def _check_silence(self) -> None:
        self._notices.count(self.joiner.dropped)
        now_ns = self._now_ns()
        for sensor in (self._scans,) if self._has_no_odometry else (self._scans, self._odometry):
            if sensor.falls_silent(now_ns):
                stopped = "" if self._steering is None else "; the robot is stopped"
                self._say(f"{sensor.name} silent", f"{sensor.name} is silent{stopped}")
                self._stop()

    def _steer(self) -> None:
        """Command by the newest odometry; a robot whose laser or odometry is silent stands."""
        if self._steering is None or self._newest is None or self._last is None or self._due:
            return
        is_unable = self._has_second_subscriber() or self.outcome is not None
        if is_unable or self._scans.is_silent or self._odometry.is_silent:
            self._stop()
            return
        (time_ns, pose), self._newest = self._newest, None
        self._steering.send(self._steering.pilot.ahead(self._last.odometry.inverse() @ pose, time_ns))

    def _has_second_subscriber(self) -> bool:
        """Whether another robot may read the commands; if that stays so, the run ends."""
        assert self._steering is not None
        now_ns = self._now_ns()
        if self._steering.subscribers() <= 1:
            self._shared_ns = None
            return False
        what = "commands: a second subscriber, which may be another robot"
        if self._shared_ns is None:
            self._shared_ns = now_ns
            self._say("second subscriber", f"{what}; the robot is stopped")
        elif now_ns - self._shared_ns > _ANNOUNCED_NS:
            self._end(ANOTHER_ROBOT, what)
        return True

    def _end(self, outcome: str, text: str) -> None:
        """End the run; a driven robot is stopped first."""
        if self.outcome is None:
            self._stop()
            self.outcome = outcome
            self._say(outcome, f"{text}; {'the run ends' if self._steering is None else 'the robot is stopped'}")

    def _stop(self) -> None:
        if self._steering is not None:
            self._steering.send(Command())

    def _say(self, kind: str, text: str) -> None:
        self._notices.event(kind, text, self._now_ns())
