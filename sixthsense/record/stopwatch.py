"""Processing times of the stages of the loop."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array

STAGES = (
    "sense",
    "ticks",
    "extract",
    "associate",
    "predict",
    "update",
    "grid",
    "plan",
    "track",
    "link",
    "loop_closure",
)


class Stopwatch:
    """Times the stages of the loop. The processing of a keyframe is the sum of its stages without sensing."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        """per keyframe, milliseconds per stage"""
        self.totals = dict.fromkeys(STAGES, 0.0)
        """per stage, milliseconds in the whole run"""
        self._row: dict[str, float] = {}
        self._waited = 0.0  # milliseconds that no stage counts

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, each of whose calls adds its time to `stage`."""

        @functools.wraps(function)
        def call(*args: Any) -> Any:
            began, waited = time.perf_counter(), self._waited
            out = function(*args)
            elapsed = 1e3 * (time.perf_counter() - began) - (self._waited - waited)
            self._row[stage] = self._row.get(stage, 0.0) + elapsed
            self.totals[stage] += elapsed
            return out

        return call

    def waiting(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time no stage counts that calls it: it waits for something."""

        @functools.wraps(function)
        def call(*args: Any) -> Any:
            began = time.perf_counter()
            out = function(*args)
            self._waited += 1e3 * (time.perf_counter() - began)
            return out

        return call

    def end_tick(self, is_keyframe: bool) -> None:
        """End a tick; the times of a tick with a keyframe are kept as a row."""
        if is_keyframe:
            self.rows.append(self._row)
        self._row = {}

    def keyframe_ms(self) -> Array:
        """(K,) processing time of each keyframe without sensing, milliseconds."""
        return np.array([sum(ms for stage, ms in row.items() if stage != "sense") for row in self.rows])
