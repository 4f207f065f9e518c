"""The offset between the clocks of scans and odometry, found as in logs while the run goes on."""

from __future__ import annotations

import threading
from collections import deque
from typing import TypeVar

import numpy as np

from sixthsense.core.laser import Scan
from sixthsense.logs.clocks import LEAST_S, clock_offset_s

_EVERY_NS = 5_000_000_000  # of scans, from one look to the next
_WINDOW_NS = 30_000_000_000  # of messages that are looked at

T = TypeVar("T")


class ClockOffset:
    """By how much the stamps of scans lead those of odometry: nothing until two looks in turn agree.

    It is known when the robot has turned enough. It is looked for in a thread of its own, since a look takes longer
    than a scan may wait.
    """

    def __init__(self, lead_ns: int = 0) -> None:
        """Begin with what is taken until it is found."""
        self.lead_ns = lead_ns
        self._scans: deque[tuple[int, Scan]] = deque()
        self._headings: deque[tuple[int, float]] = deque()
        self._looked_ns: int | None = None
        self._before_s: float | None = None
        self._look: threading.Thread | None = None
        self._is_found = self._is_sure = False

    def add_odometry(self, stamp_ns: int, heading: float) -> None:
        """Take in odometry."""
        if not self._is_sure:
            _add(self._headings, stamp_ns, heading)

    def add_scan(self, stamp_ns: int, scan: Scan) -> bool:
        """Take in a scan with its own stamp, of its first beam; whether another offset has been found since."""
        if self._is_sure:
            return False
        _add(self._scans, stamp_ns, scan)
        if self._look is not None and not self._look.is_alive():
            self._look = None
            if self._is_found:
                return self._settle()
        if self._looked_ns is None or stamp_ns < self._looked_ns:
            self._looked_ns = stamp_ns
        if self._look is None and stamp_ns - self._looked_ns >= _EVERY_NS:
            self._looked_ns = stamp_ns
            arguments = (list(self._scans), list(self._headings))
            self._look = threading.Thread(target=self._search, args=arguments, name="clocks", daemon=True)
            self._look.start()
        return False

    def _search(self, scans: list[tuple[int, Scan]], headings: list[tuple[int, float]]) -> None:
        stamps = np.array([stamp for stamp, _ in headings], dtype=np.int64)
        found_s = clock_offset_s(scans, stamps, np.array([heading for _, heading in headings]))
        before_s, self._before_s = self._before_s, found_s
        self._is_found = found_s is not None and before_s is not None and abs(found_s - before_s) < LEAST_S

    def _settle(self) -> bool:
        """Take the offset that is found; whether it is another one."""
        assert self._before_s is not None
        self._is_sure = True
        self._scans.clear()
        self._headings.clear()
        before_ns, self.lead_ns = self.lead_ns, round(1e9 * self._before_s)
        return self.lead_ns != before_ns


def _add(window: deque[tuple[int, T]], stamp_ns: int, value: T) -> None:
    """Add to the newest; a stamp that is no later begins anew."""
    if window and stamp_ns <= window[-1][0]:
        window.clear()
    window.append((stamp_ns, value))
    while stamp_ns - window[0][0] > _WINDOW_NS:
        window.popleft()
