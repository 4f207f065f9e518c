"""What is odd in the first scans and odometry of a robot: said, and nothing is changed."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from sixthsense.core.source import Tick
from sixthsense.logs.diagnose import findings_of
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.loop.run import OnTick
from sixthsense.record.trace import Trace

LOOKS_NS = (10_000_000_000, 30_000_000_000)
"""times since the first tick"""


def first_look(say: Callable[[str], object], has_odometry: bool = True) -> OnTick:
    """A hook that diagnoses the ticks so far after 10 and 30 s, in a thread, and says each finding once.

    `say` prints a line. A robot with `has_odometry` false has none that could be odd.
    """
    ticks: list[Tick] = []
    said: set[str] = set()
    left = list(LOOKS_NS)

    def look(seen: list[Tick]) -> None:
        scans = [Sighting(t.stamp_ns, t.scan, t.log_stamp_s or 1e-9 * t.stamp_ns) for t in seen if t.scan is not None]
        stamps, poses = np.array([t.stamp_ns for t in seen]), np.array([t.odometry.array() for t in seen])
        for finding in findings_of(scans, Odometry(stamps, poses) if has_odometry else None):
            if finding.kind not in said:
                said.add(finding.kind)
                say(str(finding))

    def hook(tick: Tick, trace: Trace) -> None:
        if not left:
            return
        ticks.append(tick)
        if tick.stamp_ns - ticks[0].stamp_ns >= left[0]:
            left.pop(0)
            threading.Thread(target=look, args=(list(ticks),), daemon=True, name="first look").start()
            if not left:
                ticks.clear()

    return hook
