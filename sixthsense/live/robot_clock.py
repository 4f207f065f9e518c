"""The robot's clock: the stamps of its odometry as a time that goes on when the clock jumps."""

from __future__ import annotations

JUMP_NS = 1_000_000_000
"""A stamp that differs by more from what has passed since the last one is of a clock that has jumped."""
CONFIRMED = 3
"""Messages of a new clock, one after the other, that make it the clock: a single wrong stamp is dropped."""


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
