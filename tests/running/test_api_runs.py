"""Runs and replays by names: the calls of a notebook."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.core import interrupt
from sixthsense.evaluation.measure import measure
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


def test_fields_are_given_by_name_and_sections_as_mappings():
    run = ss.run("rectangle", preset="worn", estimator="ekf-fej", seed=3, features={"landmarks": "corners"}, **SHORT)
    assert run.outcome == "tour ended"
    config = run.trace.config
    assert (config.preset, config.estimator, config.seed, config.scene) == ("worn", "ekf-fej", 3, "rectangle")
    assert config.features.landmarks == "corners"
    assert config.world.wheel_scale_error == 0.02
    assert run.name == "rectangle"


def test_a_whole_configuration_is_run_as_it_is_or_with_fields_over_it():
    config = ss.preset(scene="rectangle", **SHORT)
    ticks = []
    plain = ss.run(config, lambda tick, trace: ticks.append(tick))
    assert same(plain, ss.run("rectangle", **SHORT))
    assert len(ticks) > 100
    assert ss.run(config, seed=5).trace.config.seed == 5


def test_a_goal_is_a_goal_tasks():
    run = ss.run("rectangle", goal=(1.0, 0.5), max_time=1.0)
    assert run.trace.config.task == "goal"


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: ss.run("rectangle", esimator="ekf"), "esimator: no such field, did you mean estimator. allowed: "),
        (
            lambda: ss.run("rectangle", estimator="ukf"),
            "estimator: found 'ukf', did you mean ekf. allowed: ekf, ekf-fej",
        ),
        (lambda: ss.run("rectangle", laser={"beam": 90}), "laser.beam: no such field, did you mean beams. allowed: "),
        (lambda: ss.run("rectangle", features="corners"), "features: found 'corners', allowed: a table"),
        (lambda: ss.run("rectangle", preset="modern"), "preset: found 'modern', .*allowed: default"),
        (lambda: ss.run(ss.preset(), preset="worn"), "preset: found 'worn' with a complete configuration"),
        (lambda: ss.run("rectangle", scene="block"), "scene: found 'block' beside 'rectangle', allowed: one scene"),
        (lambda: ss.run("rectangel"), "scene: found 'rectangel', did you mean rectangle. allowed: .*rectangle"),
        (lambda: ss.run("rectangle", goal=(2.0, 2.0), task="tour"), "goal: found with task tour, allowed"),
        (
            lambda: ss.run("rectangle", goal=(0, 0), tour=[(1, 1)]),
            "^goal: found beside a tour, allowed: one of the two$",
        ),
        (lambda: ss.run("rectangle", estimator=lambda start, cov: None), "estimator: name: found '<lambda>', allowed"),
        (lambda: ss.run("rectangle", seed=-1), "seed: found -1, allowed: at least 0"),
        (lambda: ss.replay("nowhere.log"), "nowhere.log: "),
        (lambda: ss.replay("nowhere.log", planner="astar"), "planner: found on replay, allowed: options of the est"),
        (lambda: ss.replay("nowhere.log", topics=["/scan"]), "topic: found on a log that is not a ROS bag"),
    ],
)
def test_what_will_not_do_is_told_in_one_line(call, complaint):
    with pytest.raises(ss.InputError, match=complaint) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_runs_folder_is_what_the_command_writes_and_loads_as_the_run_it_was(folder):
    out, run = folder
    assert {"config.toml", "bag", "metrics.json", "estimate.tum", "figures"} <= {entry.name for entry in out.iterdir()}
    loaded = ss.load(out)
    assert same(loaded, run)
    assert loaded.name == "one"
    assert loaded.plot("error").png()[:4] == b"\x89PNG"
    with pytest.raises(ss.InputError, match="exists, allowed: a new folder"):
        ss.run("rectangle", out=out, **SHORT)


def test_what_a_bad_run_was_to_write_is_not_begun(tmp_path):
    with pytest.raises(ss.InputError):
        ss.run("rectangle", goal=(99.0, 99.0), out=tmp_path / "bad")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_replayed_with_its_own_configuration_and_fields_over_it(folder):
    out, run = folder
    assert same(ss.replay(out), run)
    other = ss.replay(str(out), estimator="ekf-invariant")
    assert other.trace.config.estimator == "ekf-invariant"
    assert other.trace.config.seed == 2
    assert other.trace.odometry[-1] == pytest.approx(run.trace.odometry[-1])


def test_the_preset_follows_the_kind_of_log(tmp_path):
    line = "FLASER 4 1.0 2.0 3.0 4.0 0.0 0.0 0.0 {x} 0.0 0.0 {stamp} nohost {stamp}\n"
    log = tmp_path / "some.log"
    log.write_text("".join(line.format(x=0.1 * k, stamp=float(k)) for k in range(5)))
    laser = {"beams": 4, "fov": 1.5}
    run = ss.replay(log, laser=laser)
    assert run.trace.config.preset == "log"
    assert run.outcome == "log ended"
    assert run.name == "some.log"
    assert ss.replay(log, preset="worn", laser=laser).trace.config.preset == "worn"
    assert ss.replay(log, ss.preset(laser=laser)).trace.config.preset == "default"
    opened = ss.open_log(log, run.trace.config.laser)
    assert len(ss.replay(opened, run.trace.config).trace.stamps_ns) == 5
    with pytest.raises(ss.ConfigError, match="config: found none for an opened log"):
        ss.replay(opened)


def test_an_interrupted_run_is_handed_over_as_far_as_it_came_and_can_be_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(interrupt, "_last_s", -np.inf)

    def press(tick, trace):
        if len(trace.stamps_ns) == 20:
            os.kill(os.getpid(), signal.SIGINT)

    run = ss.run("rectangle", press, task="tour", max_time=100.0, out=tmp_path / "cut")
    assert run.outcome == "interrupted"
    assert len(run.trace.stamps_ns) == 20
    assert run.plot().png()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / "cut" / "metrics.json").read_text())["outcome"] == "interrupted"


def test_a_ctrl_c_after_the_end_does_not_lose_what_a_run_has_found(tmp_path, monkeypatch):
    monkeypatch.setattr(interrupt, "_last_s", -np.inf)

    def measured(trace):
        os.kill(os.getpid(), signal.SIGINT)
        return measure(trace)

    monkeypatch.setattr("sixthsense.evaluation.measured_run.measure", measured)
    run = ss.run("rectangle", task="tour", max_time=3.0, out=tmp_path / "whole")
    assert json.loads((tmp_path / "whole" / "metrics.json").read_text())["outcome"] == run.outcome == "tour ended"


def test_a_tour_of_given_goals_is_driven_once_unless_its_time_is_limited():
    goals = ((0.5, 0.5), (1.0, 0.5))
    once = ss.run("rectangle", tour=goals)
    assert once.outcome == "tour ended" and np.hypot(*(once.trace.truths[-1][:2] - goals[-1])) < 0.1
    again = ss.run("rectangle", tour=goals, max_time=once.metrics["sim_time_s"] + 5.0)
    assert again.outcome == "tour ended" and again.metrics["path_length_m"] > once.metrics["path_length_m"]


class Renamed(EKF):
    """Of one's own, as far as the registry can tell."""


def straight(rng):
    """A planner of one's own."""
    assert isinstance(rng, np.random.Generator)
    return AStar()


def test_an_estimator_and_a_planner_of_ones_own_are_used_by_their_names(tmp_path):
    own = ss.run("rectangle", estimator=Renamed, planner=straight, out=tmp_path / "own", **SHORT)
    assert (own.trace.config.estimator, own.trace.config.planner) == ("Renamed", "straight")
    assert same(own, ss.run("rectangle", estimator="ekf", **SHORT))
    assert same(ss.load(tmp_path / "own"), own)
    ss.register_estimator("mine", Renamed)
    assert ss.run("rectangle", estimator="mine", max_time=1.0, task="tour").trace.config.estimator == "mine"
    for name in ("ekf", "", "two words", "x" * 99):
        with pytest.raises(ValueError, match="name: found"):
            ss.register_estimator(name, Renamed)
    with pytest.raises(ValueError, match=r"name: found .astar., allowed: .*none of astar, rrtstar"):
        ss.register_planner("astar", straight)


def test_where_nobody_looks_on_a_run_says_nothing_and_where_it_shall_it_shows_a_bar():
    code = "import sixthsense as ss; ss.run('rectangle', task='tour', max_time=3.0, progress={})"

    def said(progress, **env):
        done = subprocess.run(
            [sys.executable, "-c", code.format(progress)], capture_output=True, text=True, env=os.environ | env
        )
        assert done.returncode == 0 and done.stdout == ""
        return done.stderr

    assert said(None) == ""
    bar = said(True)
    assert "rectangle, tour" in bar and "of 3 s" in bar
    assert said(True, TQDM_DISABLE="1") == ""
