import dataclasses
import io
import time
from collections import Counter
from contextlib import redirect_stderr
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import rotation
from sixthsense.record.trace import Trace
from sixthsense.running.progress import live_status, progress, seen_area


def a_live_trace(scans: int) -> Trace:
    """Sigmas of 0.05 m along a slanted direction, of 0.02 m across it, and of half a degree."""
    trace = Trace(preset(), None, 0.2, stamps_ns=list(range(scans)), since_key=[np.zeros(3)])
    cov = np.diag([0.0, 0.0, np.radians(0.5) ** 2])
    cov[:2, :2] = rotation(0.7) @ np.diag([0.02**2, 0.05**2]) @ rotation(0.7).T
    trace.key_estimates.append(dataclasses.replace(trace.final, pose_cov=cov))
    return trace


def test_the_status_of_a_live_run_has_sigmas_rate_and_dropped_messages(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    dropped: Counter[str] = Counter()
    seen_m2 = [0.0]
    status = live_status(dropped, lambda: seen_m2[0])
    assert status(a_live_trace(3)) == "sigma 0.05 m 0.5°, 0 dropped"
    now_s[0] = 2.0
    dropped.update({"scan late": 3, "odometry twice": 1})
    assert status(a_live_trace(21)) == "sigma 0.05 m 0.5°, 9.0 scans/s, 4 dropped"
    now_s[0] = 6.0
    seen_m2[0] = 23.4
    assert status(a_live_trace(23)) == "sigma 0.05 m 0.5°, 23 m² seen, 0.5 scans/s, 4 dropped"


def at(seconds: float) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=round(seconds * 1e9))


def test_nothing_is_written_where_no_terminal_is():
    with redirect_stderr(io.StringIO()) as err, progress("a log", 10.0) as bar:
        bar.advance(at(0.0), Trace(preset(), None, 0.2))
        bar.advance(at(5.0), Trace(preset(), None, 0.2))
    assert err.getvalue() == ""


class Shown:
    """What a bar is told; each second move of it is drawn."""

    def __init__(self, shown: bool | None, **options: Any) -> None:
        self.options, self.disable, self.n, self.seconds, self.texts = options, False, 0.0, [], []

    def update(self, seconds: float) -> bool:
        self.n += seconds
        self.seconds.append(seconds)
        return len(self.seconds) % 2 == 0

    def set_postfix_str(self, text: str) -> None:
        self.texts.append(text)

    def set_description_str(self, text: str) -> None:
        self.texts.append(text)

    def close(self) -> None:
        raise OSError("the terminal has been closed")


def test_a_bar_advances_by_the_time_of_the_source_and_asks_for_the_status_where_it_is_drawn(monkeypatch):
    now_s, slept, made = [100.0], [], []
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(time, "sleep", slept.append)

    def bar_of(shown: bool | None, **options: Any) -> Shown:
        made.append(Shown(shown, **options))
        return made[0]

    monkeypatch.setattr("sixthsense.running.progress.progress_bar", bar_of)
    trace = Trace(preset(), None, 0.2)
    with progress("hall", 10.0, realtime=True, status=lambda trace: f"at {now_s[0]:g}") as (advance, say):
        say("compiling")
        say("")
        advance(at(3.0), trace)
        for source_s, wall_s in ((3.05, 100.1), (3.15, 100.2), (4.0, 100.6), (5.0, 101.7)):
            now_s[0] = wall_s
            advance(at(source_s), trace)
        advance(at(5.6), trace)
    (bar,) = made
    assert (bar.options["total"], bar.options["desc"], bar.options["mininterval"]) == (10.0, "hall", 1.0)
    assert bar.seconds == pytest.approx([0.0, 0.05, 0.1, 0.85, 1.0, 0.6]) and bar.disable
    assert bar.texts == ["hall: compiling", "hall", "at 100.1", "at 100.6", "at 101.7"]
    assert slept == pytest.approx([0.0, 0.0, 0.0, 0.4, 0.3, 0.9])


def test_an_exploration_shows_the_seen_area_beside_that_of_the_region():
    grid = SimpleNamespace(seen_area_m2=0.0)
    trace = SimpleNamespace(draw_map=lambda: grid, scene=None, config=preset(region=(-1.5, 2.0, 2.5, 5.0)))
    assert seen_area(trace) == ""
    grid.seen_area_m2 = 4.0
    assert seen_area(trace) == "4 of at most 12 m² seen"
    trace.scene = SimpleNamespace(region=(-7.0, 1.0, -2.0, 5.0))
    assert seen_area(trace) == "4 of at most 12 m² seen"
    trace.config = preset()
    assert seen_area(trace) == "4 of at most 20 m² seen"
    grid.seen_area_m2 = 25.0
    assert seen_area(trace) == "25 of at most 25 m² seen"
    trace.config = preset(task="tour")
    assert seen_area(trace) == "25 m² seen"
