"""A run's folder read back without estimating again: equal to the run, or a word on what is missing."""

import json
import shutil
import time

import numpy as np
import pytest
from mcap.reader import make_reader

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.evaluation.measure import measure
from sixthsense.figures.run import Run
from sixthsense.logs.runfolder import FILE
from sixthsense.record.trace import Stopwatch


@pytest.fixture(scope="module", params=["ekf-invariant", "isam2"])
def simulated(request, tmp_path_factory) -> Run:
    out = tmp_path_factory.mktemp("runs") / "one"
    return ss.run("rectangle", estimator=request.param, preset="worn", seed=1, out=out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short tour's folder, whose record has a chunk for each tick."""
    out = tmp_path_factory.mktemp("runs") / "tour"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sixthsense.record.stream._FLUSH_S", 0.0)
        ss.run("rectangle", task="tour", max_time=6.0, seed=4, out=out)
    return out


def refuse(constant: str) -> None:
    raise AssertionError(constant)


def test_a_simulated_run_is_read_back_with_its_metrics_which_are_strict_json(simulated):
    loaded = ss.load(simulated.folder)
    stated = json.loads((simulated.folder / "metrics.json").read_text(), parse_constant=refuse)
    assert loaded.missing == ()
    assert loaded.metrics == stated
    assert loaded.verdict.level == simulated.verdict.level
    assert json.loads(json.dumps(measure(loaded.trace))) == stated


def test_a_killed_run_has_what_was_streamed_and_says_what_is_missing(folder, tmp_path):
    whole, killed = ss.load(folder), tmp_path / "cut.partial"
    shutil.copytree(folder, killed)
    content = (killed / FILE).read_bytes()
    (killed / FILE).write_bytes(content[: len(content) * 2 // 3])
    run = ss.load(killed)
    count = len(run.trace.stamps_ns)
    assert (run.name, run.outcome) == ("cut", "interrupted")
    assert 0 < count < len(whole.trace.stamps_ns)
    assert np.array_equal(run.trace.estimates, whole.trace.estimates[:count])
    assert "the run's end" in run.missing[0] and all(part in repr(run) for part in run.missing)
    assert {"nis_mean_per_dof", "ate_rmse_m", "pose_nees_world_mean", "scan_ms_p50", "coverage"} <= set(run.metrics)
    assert run.metrics.keys().isdisjoint({"wall_time_s", "landmarks", "landmarks_culled", "walls_merged"})
    for kind in ("map", "error", "nees", "nis", "stages", "coverage"):
        assert run.plot(kind).png()
    with pytest.raises(InputError, match=r"exploration: found a run without an exploration, allowed: "):
        run.plot("exploration")


def test_a_record_is_whole_for_programs_that_read_mcap(folder):
    with (folder / FILE).open("rb") as stream:
        summary = make_reader(stream).get_summary()
        found = [message for _, channel, message in make_reader(stream).iter_messages(topics=["end"])]
    counts = {channel.topic: summary.statistics.channel_message_counts[k] for k, channel in summary.channels.items()}
    trace = ss.load(folder).trace
    assert counts["estimate"] == counts["scan"] == len(trace.stamps_ns)
    assert counts["keyframe"] == len(trace.key_stamps_ns)
    assert json.loads(found[0].data)["fields"]["outcome"] == trace.outcome


def test_a_folder_keeps_the_true_tracks_of_people_and_repeats_the_run(tmp_path):
    made = ss.run("apartment", world={"walkers": 2}, max_time=2.0, out=tmp_path / "run", progress=False)
    back = ss.load(tmp_path / "run")
    assert np.array_equal(back.trace.walkers, made.trace.walkers) and len(back.trace.walkers) == len(made.trace.truths)
    assert back.trace.touches == made.trace.touches == (0, 0) and back.metrics["touches_by_robot"] == 0
    assert back.trace.config.people
    again = ss.replay(tmp_path / "run", progress=False)
    assert np.array_equal(again.trace.trajectory, made.trace.trajectory)


def test_the_processing_of_a_keyframe_is_the_sum_of_its_stages_without_sensing(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    watch = Stopwatch()
    for stage, seconds in (("sense", 0.003), ("plan", 0.004), ("plan", 0.001)):
        with watch.stage(stage):
            now[0] += seconds
    watch.end_tick(is_keyframe=True)
    assert watch.totals["sense"] == pytest.approx(3.0)
    assert watch.rows == [pytest.approx({"sense": 3.0, "plan": 5.0})] and watch.keyframe_ms() == pytest.approx([5.0])
