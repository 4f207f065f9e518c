"""Joining scans with odometry: ticks in the order of time, from messages in any order of arrival; and who sends them.

No network and no clock of its own: stamps and times of arrival are arguments, in nanoseconds.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from typing import Literal, NamedTuple

from sixthsense.config import RobotConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick, seconds
from sixthsense.logs.log import GAP_S, JOLT_M, JOLT_RAD, pose_between

JUMP_NS = 1_000_000_000
"""A stamp that differs by more from what has passed since the last one is of a clock that has jumped."""
CONFIRMED = 3
"""Messages of a new clock, one after the other, that make it the clock: a single wrong stamp is dropped."""
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
    """Shifts stamps by what the clock has jumped. Time of arrival says how much has passed meanwhile."""

    def __init__(self) -> None:
        self.jumps = 0
        """how often the clock has jumped"""
        self._shift_ns = 0
        self._last: tuple[int, int] | None = None  # time and arrival of the latest message
        self._new: tuple[int, int, int] | None = None  # stamp, arrival and number of messages of a new clock

    def time(self, stamp_ns: int) -> int:
        """The time of a stamp, nanoseconds; equal to the stamp before the first jump."""
        return stamp_ns + self._shift_ns

    def stamp(self, time_ns: int) -> int:
        """The stamp that the robot's clock gives to a time."""
        return time_ns - self._shift_ns

    def now(self, arrival_ns: int) -> int:
        """What the robot's clock shows at a time of arrival, late by the delay of its last message; 0 before any."""
        if self._last is None:
            return 0
        time_ns, last_arrival_ns = self._last
        return self.stamp(time_ns + arrival_ns - last_arrival_ns)

    def accepts(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether a message is of the present clock; the third in turn of another clock makes that the present one."""
        time_ns = self.time(stamp_ns)
        if self._last is None:
            self._last = time_ns, arrival_ns
            return True
        last_ns, last_arrival_ns = self._last
        expected_ns = last_ns + arrival_ns - last_arrival_ns
        if last_ns - JUMP_NS <= time_ns <= expected_ns + JUMP_NS:
            self._new = None
            if time_ns > last_ns:
                self._last = time_ns, arrival_ns
            return True
        if not self._is_confirmed(stamp_ns, arrival_ns):
            return False
        self._shift_ns = expected_ns - stamp_ns
        self._last, self._new = (expected_ns, arrival_ns), None
        self.jumps += 1
        return True

    def _is_confirmed(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Take in a message of another clock; whether there have been enough that agree with each other."""
        count = 1
        if self._new is not None:
            before_ns, before_arrival_ns, before_count = self._new
            if 0 < stamp_ns - before_ns <= arrival_ns - before_arrival_ns + JUMP_NS:
                count = before_count + 1
        self._new = stamp_ns, arrival_ns, count
        return count == CONFIRMED


class _Waiting(NamedTuple):
    """A scan without odometry after it."""

    time_ns: int
    stamp_ns: int
    """of the header"""
    arrival_ns: int
    scan: Scan


class OdometryReset(NamedTuple):
    """Odometry that has begun anew."""

    time_ns: int
    """of its first message"""
    pause_s: float
    """since the last message before"""
    reach_m: float
    """the robot can have driven so far meanwhile"""
    jump_m: float
    """from the position of that message to that of the first new one"""
    T_stood_went: Pose
    """the present frame of odometry if it went on from the message before, in that if the robot stood: the jump"""


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
        self.anew: OdometryReset | None = None
        """the last time that odometry has begun anew"""
        self.T_old_odom = Pose()
        """the frame of odometry, in that of its first message: the identity until it begins anew"""
        self._odometry: list[tuple[int, Pose]] = []
        self._scans: list[_Waiting] = []
        self._last_scan_ns: int | None = None
        self._ticked_ns: int | None = None  # time of the last tick

    @property
    def newest(self) -> tuple[int, Pose] | None:
        """Time and pose of the newest odometry, `T_odom_robot`."""
        return self._odometry[-1] if self._odometry else None

    def add_odometry(self, stamp_ns: int, T_odom_robot: Pose, arrival_ns: int, is_restarted: bool = False) -> bool:
        """Take the robot's pose by its wheels; whether it is the newest and can be used.

        `is_restarted` is whether it is the first of a driver that was started again.
        """
        if not self.clock.accepts(stamp_ns, arrival_ns):
            self.dropped["odometry with a stamp of another time"] += 1
            return False
        time_ns = self.clock.time(stamp_ns)
        if self._odometry:
            newest_ns, before = self._odometry[-1]
            if time_ns <= newest_ns:
                self.dropped["odometry twice" if time_ns == newest_ns else "odometry out of order"] += 1
                return False
            went, pause_s = self.T_old_odom @ T_odom_robot, seconds(time_ns - newest_ns)
            if is_restarted or self._is_elsewhere(before, went, pause_s):
                self.T_old_odom = before @ T_odom_robot.inverse()
                reach_m = _FASTER * self._robot.speed * pause_s
                jump_m = math.dist(went.position, before.position)
                self.anew = OdometryReset(time_ns, pause_s, reach_m, jump_m, went @ before.inverse())
        self._odometry.append((time_ns, self.T_old_odom @ T_odom_robot))
        return True

    def add_scan(self, stamp_ns: int, scan: Scan, arrival_ns: int) -> None:
        """Take in a scan; `stamp_ns` is that of its first beam."""
        time_ns = self.clock.time(stamp_ns - sweep_ns(len(scan.ranges), scan.time_increment))
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

    def place(self, T: Pose, since_ns: int) -> None:
        """Move the odometry since a time, and all that follows, to `T @ pose`; what is before it is let go."""
        self.T_old_odom = T @ self.T_old_odom
        self._odometry = [(t, T @ pose) for t, pose in self._odometry if t >= since_ns]

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
        """`T_odom_robot`, interpolated between two messages; None before the first one, and in a long gap."""
        for at_ns, pose in self._odometry:
            if at_ns == time_ns:
                return pose
        for before, after in pairwise(self._odometry):
            if before[0] < time_ns < after[0] and seconds(after[0] - before[0]) <= GAP_S:
                return pose_between(before, after, time_ns)
        return None

    def _is_elsewhere(self, before: Pose, after: Pose, duration_s: float) -> bool:
        """Whether the robot does not drive so fast."""
        distance = math.hypot(after.x - before.x, after.y - before.y)
        turn = abs(wrap_angle(after.theta - before.theta))
        is_far = distance > _FASTER * self._robot.speed * duration_s + JOLT_M
        return is_far or turn > _FASTER * self._robot.turn_rate * duration_s + JOLT_RAD


Publisher = Literal["known", "new", "unknown", "second"]
"""of a message: the one that sends; one that has taken its place; one that may do so; or one beside it"""


class SilenceDetector:
    """Tells when a sensor falls silent, and when it is back."""

    def __init__(self, name: str, now_ns: int, silent_ns: int) -> None:
        """The sensor of this name has last been heard now; after `silent_ns` without a message it is silent."""
        self.is_silent = False
        self._silent_ns = silent_ns
        self.name, self._heard_ns = name, now_ns

    def heard(self, now_ns: int) -> float | None:
        """Take in a message; how long the sensor had been silent, seconds, if it had been."""
        silent_s, self._heard_ns = 1e-9 * (now_ns - self._heard_ns), now_ns
        was_silent, self.is_silent = self.is_silent, False
        return silent_s if was_silent else None

    def falls_silent(self, now_ns: int) -> bool:
        """Whether the sensor has fallen silent since the last call."""
        was_silent, self.is_silent = self.is_silent, now_ns - self._heard_ns > self._silent_ns
        return self.is_silent and not was_silent


class Publishers:
    """Tells a publisher that takes the place of another one, as after a restart of a driver, from one beside it.

    What the network announces does not tell them apart: a program that was killed is announced for some seconds more.
    """

    def __init__(self) -> None:
        self._present, self._heard_ns = "", 0
        self._former: set[str] = set()
        self._waiting = ""  # to take the place of the present one

    def heard(self, publisher: str, now_ns: int) -> Publisher:
        """Take in the publisher of a message that has arrived now."""
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
        return "new"
