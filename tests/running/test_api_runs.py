"""Runs and replays by names: the calls of a notebook."""

import json
import os
import signal

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.loop import interrupt

SHORT = {"task": "tour", "max_time": 8.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run's folder, and the run."""
    out = tmp_path_factory.mktemp("runs") / "one"
    return out, ss.run("rectangle", seed=2, out=out, **SHORT)


def same(one, two):
    return np.array_equal(one.trace.estimates, two.trace.estimates) and np.array_equal(
        one.trace.joint_cov, two.trace.joint_cov
    )


def test_a_folder_is_replayed_with_its_own_configuration_and_fields_over_it(folder):
    out, run = folder
    assert same(ss.replay(out), run)
    other = ss.replay(str(out), estimator="ekf-invariant")
    assert other.trace.config.estimator == "ekf-invariant"
    assert other.trace.config.seed == 2
    assert other.trace.odometry[-1] == pytest.approx(run.trace.odometry[-1])


def test_an_interrupted_run_is_handed_over_as_far_as_it_came_and_can_be_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(interrupt._signals, "ctrl_c_s", -np.inf)

    def press(tick, trace):
        if len(trace.stamps_ns) == 20:
            os.kill(os.getpid(), signal.SIGINT)

    run = ss.run("rectangle", press, task="tour", max_time=100.0, out=tmp_path / "cut")
    assert run.outcome == "interrupted"
    assert len(run.trace.stamps_ns) == 20
    assert run.plot().png()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / "cut" / "metrics.json").read_text())["outcome"] == "interrupted"
