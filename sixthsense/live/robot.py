"""A robot on the network as a `Source`: messages become ticks, and the robot is steered between them.

Scans are joined with odometry into ticks in the order of time, from messages in any order of arrival. The joiner knows
no network and no clock of its own: stamps and times of arrival are arguments, in nanoseconds.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config, RobotConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Command, Tick, seconds
from sixthsense.live.reading import Notices, RobotPose
from sixthsense.logs.log import JOLT_M, JOLT_RAD, Odometry, pose_at
from sixthsense.loop.interrupt import is_command_ended
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.slam.result import Step

WAIT_NS = 200_000_000
"""A scan waits at most this long for the odometry after it."""
SILENT_NS = 400_000_000
"""A sensor that has sent nothing for this long is silent where the robot is driven: it must not drive on."""
LONG_SILENT_NS = 2_000_000_000
"""The same where it is only listened to."""

_FASTER = 1.2  # than its top speed: three sigmas of the wheels' scale (5 %), and a controller that overshoots


class _Waiting(NamedTuple):
    """A scan without odometry after it."""

    stamp_ns: int
    """of the header"""
    arrival_ns: int
    scan: Scan


class ScanJoiner:
    """Makes a tick of each scan, with odometry interpolated at its stamp, and of the odometry before it.

    The stamp of a scan that took time is that of its first beam; its tick has the time of its last one. Odometry that
    begins anew elsewhere, as after a restart of its driver, goes on from where it was.
    """

    def __init__(self, robot: RobotConfig, drop: Callable[[str], object], start: Pose | None = None) -> None:
        """`robot` has the top speeds: odometry that moves faster has begun anew.

        `drop` is called with the reason for each message that cannot be used. The first odometry is at `start`, if that
        is given, in the frame of the ticks.
        """
        self._robot, self._drop, self._start = robot, drop, start
        self.T_joined_odom = Pose()
        """the frame of odometry in that of the ticks"""
        self._odometry: list[tuple[int, Pose]] = []
        self._scans: dict[int, _Waiting] = {}  # by the time of the last beam
        self._ticked_ns = -math.inf  # time of the last tick
        self._arrival_ns = 0  # of the newest odometry

    def now(self, arrival_ns: int) -> int:
        """What the robot's clock shows at a time of arrival, late by the delay of its last message; 0 before any."""
        return self._odometry[-1][0] + arrival_ns - self._arrival_ns if self._odometry else 0

    @property
    def newest(self) -> tuple[int, Pose] | None:
        """Time and pose of the newest odometry, frame of the ticks."""
        return self._odometry[-1] if self._odometry else None

    def add_odometry(self, stamp_ns: int, T_odom_robot: Pose, arrival_ns: int) -> str | None:
        """Record the robot's pose by its wheels; how it has jumped, "" if it has not; None where it is dropped."""
        jump = ""
        if not self._odometry:
            self.T_joined_odom = Pose() if self._start is None else self._start @ T_odom_robot.inverse()
        else:
            newest_ns, before = self._odometry[-1]
            if stamp_ns <= newest_ns:
                self._drop("odometry twice or out of order")
                return None
            after, pause_s = self.T_joined_odom @ T_odom_robot, seconds(stamp_ns - newest_ns)
            moved_m, turned = math.dist(after.position, before.position), abs(wrap_angle(after.theta - before.theta))
            most_m, most = (_FASTER * of * pause_s for of in (self._robot.speed, self._robot.turn_rate))
            if moved_m > most_m + JOLT_M or turned > most + JOLT_RAD:  # the robot does not drive so fast
                self.T_joined_odom = before @ T_odom_robot.inverse()
                jump = f"odometry has jumped by {moved_m:.1f} m after {pause_s:.1f} s"
        self._odometry.append((stamp_ns, self.T_joined_odom @ T_odom_robot))
        self._arrival_ns = arrival_ns
        return jump

    def add_scan(self, stamp_ns: int, scan: Scan, arrival_ns: int) -> bool:
        """Record a scan; `stamp_ns` is that of its first beam. False for one that is dropped."""
        time_ns = stamp_ns - sweep_ns(len(scan.ranges), scan.time_increment)
        if time_ns <= self._ticked_ns or time_ns in self._scans:
            self._drop("scan twice or late")
            return False
        self._scans[time_ns] = _Waiting(stamp_ns, arrival_ns, scan)
        return True

    def ticks(self, arrival_ns: int) -> list[Tick]:
        """The ticks that are due at a time of arrival, in ascending order: each scan, after the odometry before it."""
        found: list[Tick] = []
        for time_ns, waiting in sorted(self._scans.items(), key=lambda item: item[0]):
            is_ahead = not self._odometry or time_ns > self._odometry[-1][0]
            if is_ahead and arrival_ns - waiting.arrival_ns <= WAIT_NS:
                continue
            del self._scans[time_ns]
            if is_ahead or (pose := self._odometry_at(time_ns)) is None:
                self._drop("scan without odometry")
                continue
            past = [(t, at) for t, at in self._odometry if t <= time_ns]
            found += [Tick(t, at) for t, at in past if self._ticked_ns < t < time_ns]
            found.append(Tick(time_ns, pose, waiting.scan, log_stamp_s=waiting.stamp_ns / 1e9))
            self._ticked_ns = time_ns
            del self._odometry[: max(len(past) - 1, 0)]  # the last one is kept to interpolate
        return found

    def _odometry_at(self, time_ns: int) -> Pose | None:
        """`T_joined_robot` at a time before the newest message, as `logs.joining` has it; None where it is unknown."""
        stamps, poses = zip(*self._odometry, strict=True)
        known = Odometry(np.array(stamps), np.array([pose.array() for pose in poses]))
        (row,) = pose_at(known, np.array([time_ns]))
        return Pose.from_array(row) if np.isfinite(row).all() else None


class Sensor:
    """Who sends a topic, and whether it is silent."""

    def __init__(self, name: str, now_ns: int, silent_ns: int) -> None:
        """The sensor of this name has last been heard now; after `silent_ns` without a message it is silent."""
        self.name, self.heard_ns, self.is_silent = name, now_ns, False
        self._silent_ns, self._publisher = silent_ns, ""

    def is_of_one(self, publisher: str, now_ns: int) -> bool:
        """Record who has sent a message that has arrived now; false for one beside another publisher.

        One that takes its place, as after a restart, sends once the other has been silent for some time.
        """
        if publisher != self._publisher and self._publisher and now_ns - self.heard_ns < SILENT_NS:
            return False
        self._publisher = publisher
        return True

    def falls_silent(self, now_ns: int) -> bool:
        """Whether the sensor has fallen silent since the last call."""
        was_silent, self.is_silent = self.is_silent, now_ns - self.heard_ns > self._silent_ns
        return self.is_silent and not was_silent


class AheadPilot(Pilot):
    """Steers a robot whose scans arrive late: by the last step and the odometry since."""

    def __init__(self, navigator: Navigator, guard: Guard) -> None:
        super().__init__(navigator, guard)
        self._step: Step | None = None
        self._since_scan = Pose()  # motion from the last scan to the last step
        self._guarded = Pose()  # motion from the last scan that the guard knows of
        self._command = Command()

    def steer(self, step: Step) -> Command:
        """Record a step; the command in force, which the newest odometry has made, and not this late step."""
        if step.increment is not None:
            self._since_scan = self._since_scan @ step.increment.motion
        if step.scan is not None:
            # The guard has followed newer odometry: it goes back to where the scan was taken, or the returns of earlier
            # scans would be moved once more by the motion since.
            self.guard.moved(self._guarded.inverse() @ self._since_scan)
            self._since_scan = self._guarded = Pose()
        self.look(step)
        self._step = step
        return self._command

    def ahead(self, motion: Pose, stamp_ns: int) -> Command:
        """The command of a robot that has moved by `motion` since the last step; a standstill before the first scan."""
        if self._step is None:
            return Command()
        since_scan = self._since_scan @ motion
        self.guard.moved(self._guarded.inverse() @ since_scan)
        self._guarded = since_scan
        self._command = self.command(self._step.pose @ motion, stamp_ns)
        return self._command


ANOTHER_ROBOT, LOST = "another robot", "lost"
"""outcomes of a run that the robot itself ends"""

_WAIT_S = 0.02

Received = tuple[str, RobotPose | tuple[int, Scan]]
"""who has sent a message, and what it holds: odometry, or a scan and its stamp"""


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
        notices: Notices,
        config: Config,
        steering: Steering | None = None,
        start: Pose | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`receive(timeout_s)` waits for messages at most so long; `now_ns` is the time of their arrival.

        The map begins at `start`, `T_map_robot`, without it at the robot's pose in the frame of odometry.
        """
        self.joiner = ScanJoiner(config.robot, notices.drop, start)
        self.odom_frame = "odom"
        self.outcome: str | None = None
        """why the run ends, None as long as the robot can be used"""
        self._receive, self._now_ns, self._notices, self._steering = receive, now_ns, notices, steering
        silent_ns = LONG_SILENT_NS if steering is None else SILENT_NS
        self._scans, self._odometry = (Sensor(name, now_ns(), silent_ns) for name in ("laser", "odometry"))
        self._due: deque[Tick] = deque()
        self._last: Tick | None = None
        self._newest: tuple[int, Pose] | None = None  # odometry that the robot has not been steered by

    def step(self, command: Command) -> Tick | None:
        """Wait for the next tick; None when the run is to end. The robot is steered meanwhile."""
        self._last = self._due.popleft() if self._wait() else None
        return self._last

    def begin(self, most_s: float = math.inf) -> Pose | None:
        """Wait for the first tick, at most so long; the odometry of it, None when the run is to end."""
        return self._due[0].odometry if self._wait(self._now_ns() + 1e9 * most_s) else None

    def odom_in_map(self, tick: Tick, T_map_robot: Pose) -> Pose:
        """The frame of odometry in that of the map, by the robot's pose at a tick."""
        T_odom_robot = self.joiner.T_joined_odom.inverse() @ tick.odometry
        return T_map_robot @ T_odom_robot.inverse()

    def _wait(self, until_ns: float = math.inf) -> bool:
        """Wait for a tick; false when the run is to end, or none has come by then."""
        while not self._due:
            if is_command_ended() or self.outcome is not None or self._now_ns() > until_ns:
                return False
            self._turn()
        return True

    def _turn(self) -> None:
        """Read what has arrived, and steer by it."""
        self._read_messages()
        self._due += self.joiner.ticks(self._now_ns())
        self._check_silence()
        self._steer()

    def _read_messages(self) -> None:
        for publisher, found in self._receive(_WAIT_S):
            arrival_ns = self._now_ns()
            sensor = self._odometry if isinstance(found, RobotPose) else self._scans
            if not sensor.is_of_one(publisher, arrival_ns):
                self._end(ANOTHER_ROBOT, f"{sensor.name}: a second publisher sends beside the first")
                return
            if isinstance(found, RobotPose):
                is_used = self._add_odometry(found, arrival_ns)
            else:
                is_used = self.joiner.add_scan(*found, arrival_ns)
            if is_used:
                if sensor.is_silent:
                    self._say(f"{sensor.name} again", f"{sensor.name} sends again")
                sensor.heard_ns, sensor.is_silent = arrival_ns, False

    def _add_odometry(self, found: RobotPose, arrival_ns: int) -> bool:
        """Record odometry, false for one that is dropped.

        A driven robot is lost after a jump; one that is listened to goes on from where it was.
        """
        jump = self.joiner.add_odometry(found.stamp_ns, found.T_odom_robot, arrival_ns)
        if jump is None:
            return False
        self.odom_frame, self._newest = found.frame or "odom", self.joiner.newest
        if jump and self._steering is not None:
            self._end(LOST, jump)
        elif jump:
            self._say("odometry jumped", f"{jump}; the robot is assumed to stand where it was")
        return True

    def _check_silence(self) -> None:
        for sensor in (self._scans, self._odometry):
            if sensor.falls_silent(self._now_ns()):
                stopped = "" if self._steering is None else "; the robot is stopped"
                self._say(f"{sensor.name} silent", f"{sensor.name} is silent{stopped}")
                self._stop()

    def _steer(self) -> None:
        """Command by the newest odometry; a robot stands while a sensor is silent or another may read the commands."""
        if self._steering is None or self._newest is None or self._last is None or self._due:
            return
        if is_shared := self._steering.subscribers() > 1:
            text = "commands: a second subscriber, which may be another robot; the robot is stopped while it is there"
            self._say("second subscriber", text)
        if is_shared or self.outcome is not None or self._scans.is_silent or self._odometry.is_silent:
            self._stop()
            return
        (time_ns, pose), self._newest = self._newest, None
        self._steering.send(self._steering.pilot.ahead(self._last.odometry.inverse() @ pose, time_ns))

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
