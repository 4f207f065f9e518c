import dataclasses
import io
import time
from collections import Counter
from contextlib import redirect_stderr
from types import SimpleNamespace

import numpy as np

from sixthsense.config import preset
from sixthsense.record.trace import Trace
from sixthsense.running.progress import LiveStatus, Progress, seen_area


def a_live_trace(scans: int) -> Trace:
    trace = Trace(preset(), None, 0.2, stamps_ns=list(range(scans)), since_key=[np.zeros(3)])
    cov = np.diag([4e-4, 1e-4, np.radians(0.5) ** 2])
    trace.key_estimates.append(dataclasses.replace(trace.final, pose_cov=cov))
    return trace


def test_the_status_of_a_live_run_has_sigmas_rate_and_dropped_messages(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    dropped: Counter[str] = Counter()
    status = LiveStatus(dropped)
    assert status(a_live_trace(1)) == "sigma 0.02 m 0.5°, 0 dropped"
    now_s[0] = 2.0
    dropped.update({"scan late": 3, "odometry twice": 1})
    assert status(a_live_trace(21)) == "sigma 0.02 m 0.5°, 10.0 scans/s, 4 dropped"


def at(seconds: float) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=round(seconds * 1e9))


def test_nothing_is_written_where_no_terminal_is():
    with redirect_stderr(io.StringIO()) as err, Progress("a log", 10.0) as bar:
        bar(at(0.0), Trace(preset(), None, 0.2))
        bar(at(5.0), Trace(preset(), None, 0.2))
    assert err.getvalue() == ""


def test_an_exploration_shows_the_seen_area_beside_that_of_the_region():
    grid = SimpleNamespace(seen_area_m2=0.0)
    trace = SimpleNamespace(grid=grid, scene=None, config=preset(region=(0.0, 0.0, 4.0, 3.0)))
    assert seen_area(trace) == ""
    grid.seen_area_m2 = 4.0
    assert seen_area(trace) == "4 of at most 12 m² seen"
    trace.config = preset(task="tour")
    assert seen_area(trace) == "4 m² seen"
