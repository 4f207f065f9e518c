import dataclasses
import io
import time
from collections import Counter
from contextlib import redirect_stderr
from types import SimpleNamespace

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import rotation
from sixthsense.record.trace import Trace
from sixthsense.running.progress import LiveStatus, Progress


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
    status = LiveStatus(dropped)
    assert status(a_live_trace(3)) == "sigma 0.05 m 0.5°, 0 dropped"
    now_s[0] = 2.0
    dropped.update({"scan late": 3, "odometry twice": 1})
    assert status(a_live_trace(21)) == "sigma 0.05 m 0.5°, 9.0 scans/s, 4 dropped"
    now_s[0] = 6.0
    assert status(a_live_trace(23)) == "sigma 0.05 m 0.5°, 0.5 scans/s, 4 dropped"


def at(seconds: float) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=round(seconds * 1e9))


def test_nothing_is_written_where_no_terminal_is():
    with redirect_stderr(io.StringIO()) as err, Progress("a log", 10.0) as bar:
        bar(at(0.0), Trace(preset(), None, 0.2))
        bar(at(5.0), Trace(preset(), None, 0.2))
    assert err.getvalue() == ""
