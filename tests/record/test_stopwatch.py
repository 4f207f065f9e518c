"""Times of stages, by a clock that the test moves."""

import time

import pytest

from sixthsense.record.trace import Stopwatch


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return now


def pass_time(clock, seconds):
    clock[0] += seconds


def test_time_that_is_waited_is_in_no_stage(clock):
    watch = Stopwatch()
    wait = watch.waiting(pass_time)

    def receive():
        pass_time(clock, 0.002)
        wait(clock, 5.0)
        pass_time(clock, 0.001)

    watch.timed("sense", receive)()
    wait(clock, 7.0)
    watch.timed("plan", pass_time)(clock, 0.004)
    watch.end_tick(is_keyframe=True)
    assert watch.totals["sense"] == pytest.approx(3.0)
    assert watch.rows == [pytest.approx({"sense": 3.0, "plan": 4.0})]
    assert watch.keyframe_ms() == pytest.approx([4.0])
