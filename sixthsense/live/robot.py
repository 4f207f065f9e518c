"""A robot on the network as a `Source`: messages become ticks, and the robot is steered between them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

from sixthsense.core.geometry import Pose
from sixthsense.core.interrupt import is_command_ended
from sixthsense.core.source import Command, Tick
from sixthsense.live.joining import ScanJoiner
from sixthsense.live.notices import Notices
from sixthsense.live.presence import LONG_SILENT_NS, SILENT_NS, Presence
from sixthsense.live.reading import LaserReader, MessageReader
from sixthsense.navigation.pilot import AheadPilot

_WAIT_S = 0.02

Received = tuple[bool, bytes]
"""whether a message is a scan, else odometry; and its bytes"""


class Steering(NamedTuple):
    """How a robot is driven."""

    pilot: AheadPilot
    send: Callable[[Command], object]


class LiveRobot:
    """A robot that sends scans and odometry, and takes commands if it is to be driven."""

    def __init__(
        self,
        receive: Callable[[float], Iterable[Received]],
        reader: MessageReader,
        laser: LaserReader,
        notices: Notices,
        steering: Steering | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`receive(timeout_s)` waits for messages at most so long; `now_ns` is the time of their arrival."""
        self.joiner = ScanJoiner()
        self.odom_frame = "odom"
        self._receive, self._now_ns = receive, now_ns
        self._reader, self._laser, self._notices, self._steering = reader, laser, notices, steering
        silent_ns = LONG_SILENT_NS if steering is None else SILENT_NS
        self._scans, self._odometry = (Presence(name, now_ns(), silent_ns) for name in ("laser", "odometry"))
        self._due: deque[Tick] = deque()
        self._last: Tick | None = None
        self._newest: tuple[int, Pose] | None = None  # odometry that the robot has not been steered by

    def step(self, command: Command) -> Tick | None:
        """Wait for the next tick; None when the command line is to end. The robot is steered meanwhile."""
        if not self._wait():
            return None
        self._last = self._due.popleft()
        return self._last

    def begin(self) -> Pose | None:
        """Wait for the first tick; the odometry of it, None when the command line is to end."""
        return self._due[0].odometry if self._wait() else None

    def odom_in_map(self, tick: Tick, T_map_robot: Pose) -> Pose:
        """The frame of odometry in that of the map, by the robot's pose at a tick."""
        T_odom_robot = self.joiner.T_old_odom.inverse() @ tick.odometry
        return T_map_robot @ T_odom_robot.inverse()

    def _wait(self) -> bool:
        """Wait for a tick; false when the command line is to end."""
        while not self._due:
            if is_command_ended():
                return False
            self._turn()
        return True

    def _turn(self) -> None:
        """Take what has arrived, and steer by it."""
        self._take_messages()
        self._due.extend(self.joiner.ticks(self._now_ns()))
        self._tell()
        self._steer()

    def _take_messages(self) -> None:
        for is_scan, data in self._receive(_WAIT_S):
            arrival_ns = self._now_ns()
            try:
                if is_scan:
                    stamp_ns, scan = self._laser.scan(data)
                    self.joiner.add_scan(stamp_ns, scan, arrival_ns)
                else:
                    self._take_odometry(data, arrival_ns)
            except ValueError as error:
                self._notices.unusable("scan" if is_scan else "odometry", error)
                continue
            sensor = self._scans if is_scan else self._odometry
            if (silent_s := sensor.heard(arrival_ns)) is not None:
                self._say(f"{sensor.name} again", f"{sensor.name} sends again, after {silent_s:.1f} s")

    def _take_odometry(self, data: bytes, arrival_ns: int) -> None:
        message = self._reader.odometry(data)
        jumps, restarts = self.joiner.clock.jumps, self.joiner.restarts
        if self.joiner.add_odometry(message.stamp_ns, message.T_odom_robot, arrival_ns):
            self.odom_frame = message.frame or "odom"
            self._newest = self.joiner.newest
        if self.joiner.clock.jumps > jumps:
            self._say("clock jumped", "the robot's clock has jumped; the map goes on")
        if self.joiner.restarts > restarts:
            self._say("odometry anew", "odometry has begun anew elsewhere; the robot is taken to stand where it was")

    def _tell(self) -> None:
        self._notices.take(self.joiner.dropped)
        now_ns = self._now_ns()
        for sensor in (self._scans, self._odometry):
            if sensor.falls_silent(now_ns):
                stopped = "" if self._steering is None else "; the robot is stopped"
                self._say(f"{sensor.name} silent", f"{sensor.name} is silent{stopped}")
                self._stop()

    def _steer(self) -> None:
        """Command by the newest odometry; a robot whose laser or odometry is silent stands."""
        if self._steering is None or self._newest is None or self._last is None or self._due:
            return
        if self._scans.is_silent or self._odometry.is_silent:
            self._stop()
            return
        (time_ns, pose), self._newest = self._newest, None
        motion = self._last.odometry.inverse() @ pose
        self._steering.send(self._steering.pilot.ahead(motion, time_ns))

    def _stop(self) -> None:
        if self._steering is not None:
            self._steering.send(Command())

    def _say(self, kind: str, text: str) -> None:
        self._notices.event(kind, text, self._now_ns())
