import dataclasses
import io
from collections import Counter
from contextlib import redirect_stderr
from types import SimpleNamespace

import numpy as np

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


def test_the_status_of_a_live_run_has_sigmas_area_and_dropped_messages():
    dropped: Counter[str] = Counter()
    seen_m2 = [0.0]
    status = live_status(dropped, lambda: seen_m2[0])
    assert status(a_live_trace(3)) == "sigma 0.05 m 0.5°, 0 dropped"
    dropped.update({"scan late": 3, "odometry twice": 1})
    seen_m2[0] = 23.4
    assert status(a_live_trace(21)) == "sigma 0.05 m 0.5°, 23 m² seen, 4 dropped"


def at(seconds: float) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=round(seconds * 1e9))


def test_nothing_is_written_where_no_terminal_is():
    with redirect_stderr(io.StringIO()) as err, progress("a log", 10.0) as bar:
        bar.advance(at(0.0), Trace(preset(), None, 0.2))
        bar.advance(at(5.0), Trace(preset(), None, 0.2))
    assert err.getvalue() == ""


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
