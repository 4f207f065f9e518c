"""Where the time of a run goes: the stages of the loop, timed."""

from __future__ import annotations

import time

import numpy as np

from sixthsense.core.geometry import Array

STAGES = ("sense", "extract", "associate", "predict", "update", "grid", "plan")


class Stopwatch:
    """Times the stages of the loop; a key scan's whole processing is the sum of its stages after sensing."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        """per key scan, milliseconds per stage"""
        self.totals = dict.fromkeys(STAGES, 0.0)
        """per stage, milliseconds in the whole run"""
        self._row: dict[str, float] = {}
        self._last = time.perf_counter()

    def start(self) -> None:
        """Begin a turn of the loop."""
        self._row = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage`."""
        now = time.perf_counter()
        elapsed = 1e3 * (now - self._last)
        self._row[stage] = self._row.get(stage, 0.0) + elapsed
        self.totals[stage] += elapsed
        self._last = now

    def key_scan(self) -> None:
        """Keep this turn's laps as a key scan's."""
        self.rows.append(self._row)

    def key_scan_ms(self) -> Array:
        """(K,) the whole processing of each key scan, sensing left out; milliseconds."""
        return np.array([sum(ms for stage, ms in row.items() if stage != "sense") for row in self.rows])
