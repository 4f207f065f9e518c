"""Runs and replays by names: the calls of a notebook."""

import json
import os
import signal

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.loop import interrupt
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.estimators.ekf import EKF

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


class Renamed(EKF):
    """An estimator of one's own, as far as the configuration can tell."""


def straight(rng):
    """A planner of one's own."""
    assert isinstance(rng, np.random.Generator)
    return AStar()


def test_an_estimator_and_a_planner_of_ones_own_are_used_by_their_names(tmp_path):
    own = ss.run("rectangle", estimator=Renamed, planner=straight, out=tmp_path / "own", **SHORT)
    config = own.trace.config
    assert (config.estimator, config.planner) == (f"{__name__}:Renamed", f"{__name__}:straight")
    assert same(own, ss.run("rectangle", estimator="ekf", **SHORT))
    assert same(ss.load(tmp_path / "own"), own)
    by_path = ss.run("rectangle", estimator=f"{__name__}:Renamed", max_time=1.0, task="tour")
    assert by_path.trace.config.estimator == config.estimator
    with pytest.raises(ss.InputError, match=r"planner: found .*<lambda>, allowed: a class or function at the top"):
        ss.run("rectangle", planner=lambda rng: AStar())
