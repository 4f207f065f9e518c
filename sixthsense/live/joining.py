"""Joining scans with odometry: ticks in the order of time, from messages in any order of arrival; and who sends them.

No network and no clock of its own: stamps and times of arrival are arguments, in nanoseconds.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

from sixthsense.config import RobotConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick, seconds
from sixthsense.logs.joining import GAP_S, JOLT_M, JOLT_RAD, pose_between

JUMP_NS = 1_000_000_000
"""A stamp that differs by more from what has passed since the last one is of a clock that has jumped."""
CONFIRMED = 3
"""Messages of another time, one after the other, that tell that the clock has jumped."""
WAIT_NS = 200_000_000
"""A scan waits at most this long for the odometry after it."""
HOLD_NS = 1_000_000_000
"""Odometry is held this long for scans that are late."""
SILENT_NS = 400_000_000
"""A sensor that has sent nothing for this long is silent where the robot is driven: it must not drive on."""
LONG_SILENT_NS = 2_000_000_000
"""The same where it is only listened to."""

_FASTER = 1.2  # than its top speed: three sigmas of the wheels' scale (5 %), and a controller that overshoots


class RobotClock:
    """Compares stamps with times of arrival: one that is wrong is dropped, several in turn are a jump of the clock."""

    def __init__(self) -> None:
        self.has_jumped = False
        """whether several messages in turn had stamps of another time"""
        self._last: tuple[int, int] | None = None  # stamp and arrival of the latest message
        self._others = 0  # in turn, of another time

    def now(self, arrival_ns: int) -> int:
        """What the robot's clock shows at a time of arrival, late by the delay of its last message; 0 before any."""
        return 0 if self._last is None else self._last[0] + arrival_ns - self._last[1]

    def accepts(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether a stamp is near the time that the clock shows."""
        if self._last is None:
            self._last = stamp_ns, arrival_ns
        is_near = self._last[0] - JUMP_NS <= stamp_ns <= self.now(arrival_ns) + JUMP_NS
        self._others = 0 if is_near else self._others + 1
        self.has_jumped |= self._others == CONFIRMED
        if is_near and stamp_ns > self._last[0]:
            self._last = stamp_ns, arrival_ns
        return is_near


class _Waiting(NamedTuple):
    """A scan without odometry after it."""

    time_ns: int
    stamp_ns: int
    """of the header"""
    arrival_ns: int
    scan: Scan


class OdometryJump(NamedTuple):
    """Odometry that has begun anew."""

    pause_s: float
    """since the message before"""
    jump_m: float
    """from the position of that message to that of the first new one"""
    reach_m: float
    """the robot can have driven so far meanwhile"""


class ScanJoiner:
    """Makes a tick of each scan, with odometry interpolated at its stamp, and of the odometry before it.

    The stamp of a scan that took time is that of its first beam; its tick has the time of its last one. A scan that
    cannot be used is dropped and counted by reason. Odometry that begins anew elsewhere, as after a restart of its
    driver, goes on from where it was.
    """

    def __init__(self, robot: RobotConfig | None = None) -> None:
        """`robot` has the top speeds: odometry that moves faster has begun anew."""
        self._robot = robot or RobotConfig()
        self.clock = RobotClock()
        self.dropped: Counter[str] = Counter()
        """number of messages by reason"""
        self.T_joined_odom = Pose()
        """the frame of odometry in that of the ticks: the identity until odometry begins anew or `begin_at`"""
        self._odometry: list[tuple[int, Pose]] = []
        self._scans: list[_Waiting] = []
        self._last_scan_ns: int | None = None
        self._ticked_ns: int | None = None  # time of the last tick

    @property
    def newest(self) -> tuple[int, Pose] | None:
        """Time and pose of the newest odometry, frame of the ticks."""
        return self._odometry[-1] if self._odometry else None

    def add_odometry(self, stamp_ns: int, T_odom_robot: Pose, arrival_ns: int) -> OdometryJump | None:
        """Record the robot's pose by its wheels; how it has jumped, if it has."""
        if not self.clock.accepts(stamp_ns, arrival_ns):
            self.dropped["odometry with a stamp of another time"] += 1
            return None
        time_ns, jump = stamp_ns, None
        if self._odometry:
            newest_ns, before = self._odometry[-1]
            if time_ns <= newest_ns:
                self.dropped["odometry twice" if time_ns == newest_ns else "odometry out of order"] += 1
                return None
            after, pause_s = self.T_joined_odom @ T_odom_robot, seconds(time_ns - newest_ns)
            if self._is_elsewhere(before, after, pause_s):
                self.T_joined_odom = before @ T_odom_robot.inverse()
                jump_m = math.dist(after.position, before.position)
                jump = OdometryJump(pause_s, jump_m, _FASTER * self._robot.speed * pause_s)
        self._odometry.append((time_ns, self.T_joined_odom @ T_odom_robot))
        return jump

    def add_scan(self, stamp_ns: int, scan: Scan, arrival_ns: int) -> None:
        """Record a scan; `stamp_ns` is that of its first beam."""
        time_ns = stamp_ns - sweep_ns(len(scan.ranges), scan.time_increment)
        if time_ns == self._last_scan_ns or any(time_ns == other.time_ns for other in self._scans):
            self.dropped["scan twice"] += 1
        elif self._ticked_ns is not None and time_ns <= self._ticked_ns:
            self.dropped["scan late"] += 1
        else:
            self._scans.append(_Waiting(time_ns, stamp_ns, arrival_ns, scan))
            self._scans.sort(key=lambda waiting: waiting.time_ns)

    def ticks(self, arrival_ns: int) -> list[Tick]:
        """The ticks that are due at a time of arrival, in ascending order."""
        found: list[Tick] = []
        left: list[_Waiting] = []
        for waiting in self._scans:
            if not self._odometry or waiting.time_ns > self._odometry[-1][0]:
                if arrival_ns - waiting.arrival_ns <= WAIT_NS:
                    left.append(waiting)
                else:
                    self.dropped["scan without odometry"] += 1
            elif (pose := self._odometry_at(waiting.time_ns)) is None:
                self.dropped["scan without odometry"] += 1
            else:
                found += self._odometry_before(waiting.time_ns)
                found.append(Tick(waiting.time_ns, pose, waiting.scan, log_stamp_s=waiting.stamp_ns / 1e9))
                self._last_scan_ns = self._ticked_ns = waiting.time_ns
        self._scans = left
        if self._odometry:
            found += self._odometry_before(self._odometry[-1][0] - HOLD_NS)
        return found

    def begin_at(self, T_joined_robot: Pose) -> None:
        """Let the newest odometry be at a pose; what is before it is dropped. Before the first tick alone."""
        newest_ns, pose = self._odometry[-1]
        self.T_joined_odom = T_joined_robot @ pose.inverse() @ self.T_joined_odom
        self._odometry = [(newest_ns, T_joined_robot)]

    def _odometry_before(self, time_ns: int) -> list[Tick]:
        """Ticks of the odometry before a time that have not been made yet; the last one is kept to interpolate."""
        ticked_ns = -math.inf if self._ticked_ns is None else self._ticked_ns
        fresh = [(t, pose) for t, pose in self._odometry if ticked_ns < t < time_ns]
        if fresh:
            self._ticked_ns = fresh[-1][0]
        past = sum(t <= time_ns for t, _ in self._odometry)
        del self._odometry[: max(past - 1, 0)]
        return [Tick(t, pose) for t, pose in fresh]

    def _odometry_at(self, time_ns: int) -> Pose | None:
        """`T_joined_robot`, interpolated between two messages; None before the first one, and in a long gap."""
        row = sum(t < time_ns for t, _ in self._odometry)
        around = self._odometry[max(row - 1, 0) : row + 1]
        if around[-1][0] == time_ns:
            return around[-1][1]
        if len(around) < 2 or seconds(around[1][0] - around[0][0]) > GAP_S:
            return None
        return pose_between(around[0], around[1], time_ns)

    def _is_elsewhere(self, before: Pose, after: Pose, duration_s: float) -> bool:
        """Whether the robot does not drive so fast."""
        turn = abs(wrap_angle(after.theta - before.theta))
        is_far = math.dist(after.position, before.position) > _FASTER * self._robot.speed * duration_s + JOLT_M
        return bool(is_far or turn > _FASTER * self._robot.turn_rate * duration_s + JOLT_RAD)


class SilenceDetector:
    """Finds when a sensor falls silent, and when it is back."""

    def __init__(self, name: str, now_ns: int, silent_ns: int) -> None:
        """The sensor of this name has last been heard now; after `silent_ns` without a message it is silent."""
        self.is_silent = False
        self._silent_ns = silent_ns
        self.name, self._heard_ns = name, now_ns

    def heard(self, now_ns: int) -> float | None:
        """Record the time of a message; how long the sensor had been silent, seconds, if it had been."""
        silent_s, self._heard_ns = 1e-9 * (now_ns - self._heard_ns), now_ns
        was_silent, self.is_silent = self.is_silent, False
        return silent_s if was_silent else None

    def falls_silent(self, now_ns: int) -> bool:
        """Whether the sensor has fallen silent since the last call."""
        was_silent, self.is_silent = self.is_silent, now_ns - self._heard_ns > self._silent_ns
        return self.is_silent and not was_silent


Publisher = Literal["known", "unknown", "second"]
"""of a message: the one that sends; one that may have taken its place; or one beside it"""


class Publishers:
    """Distinguishes a publisher that takes the place of another one, as after a restart, from one beside it.

    What the network announces does not: a program that was killed is announced for some seconds more.
    """

    def __init__(self) -> None:
        self._present, self._heard_ns = "", 0
        self._former: set[str] = set()
        self._waiting = ""  # to take the place of the present one

    def heard(self, publisher: str, now_ns: int) -> Publisher:
        """Record who has sent a message that has arrived now."""
        if publisher == self._present or not self._present:
            self._present, self._heard_ns = publisher, now_ns
            return "second" if self._waiting else "known"
        if publisher in self._former or self._waiting not in ("", publisher):
            return "second"
        self._waiting = publisher
        if now_ns - self._heard_ns < SILENT_NS:
            return "unknown"
        self._former.add(self._present)
        self._present, self._heard_ns, self._waiting = publisher, now_ns, ""
        return "known"
