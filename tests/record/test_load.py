"""A run's folder read back without estimating again: equal to the run, or a word on what is missing."""

import json
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.evaluation.measure import measure
from sixthsense.figures.run import Run
from sixthsense.record.store import END_FILE, FILE, record_writer
from sixthsense.record.trace import Stopwatch


@pytest.fixture(scope="module", params=["ekf-invariant", "isam2"])
def simulated(request, tmp_path_factory) -> Run:
    out = tmp_path_factory.mktemp("runs") / "one"
    return ss.run("rectangle", estimator=request.param, preset="worn", seed=1, out=out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A short tour's folder."""
    out = tmp_path_factory.mktemp("runs") / "tour"
    ss.run("rectangle", task="tour", max_time=6.0, seed=4, out=out)
    return out


def refuse(constant: str) -> None:
    raise AssertionError(constant)


def test_a_simulated_run_is_read_back_with_its_metrics_which_are_strict_json(simulated):
    loaded = ss.load(simulated.folder)
    stated = json.loads((simulated.folder / "metrics.json").read_text(), parse_constant=refuse)
    assert loaded.missing == ()
    assert loaded.metrics == stated
    # The record has no bearings of observations, which tell a landmark's identity.
    measured = {key: value for key, value in stated.items() if key != "landmark_nees_mean"}
    assert json.loads(json.dumps(measure(loaded.trace))) == measured


def copied(folder: Path, out: Path, *without: str) -> Path:
    return Path(shutil.copytree(folder, out, ignore=lambda where, names: [name for name in names if name in without]))


def test_a_killed_run_has_what_was_streamed_and_says_what_is_missing(folder, tmp_path):
    whole = ss.load(folder)
    written = ("metrics.json", "estimate.tum", "smoothed.tum", "truth.tum", "landmarks.csv", END_FILE)
    killed = copied(folder, tmp_path / "cut.partial", *written)
    lines = (killed / FILE).read_bytes().splitlines(keepends=True)
    (killed / FILE).write_bytes(b"".join(lines[:30]) + lines[30][:20])
    run = ss.load(killed)
    count = len(run.trace.stamps_ns)
    assert (run.name, run.outcome) == ("cut", "interrupted")
    assert 0 < count < len(whole.trace.stamps_ns)
    assert np.array_equal(run.trace.estimates, whole.trace.estimates[:count])
    files = [part.rpartition("(")[2].rstrip(")") for part in run.missing]
    assert files == [END_FILE, END_FILE, "metrics.json"]
    assert "the run's end" in run.missing[0]
    assert all(part in repr(run) for part in run.missing)
    assert {"nis_mean_per_dof", "ate_rmse_m", "pose_nees_world_mean", "scan_ms_p50", "coverage"} <= set(run.metrics)
    assert run.metrics.keys().isdisjoint({"wall_time_s", "landmarks", "landmarks_culled", "walls_merged"})
    for kind in ("map", "error", "nees", "nis", "stages", "coverage"):
        assert run.plot(kind).png()
    with pytest.raises(InputError, match=r"exploration: found a folder without the grid map \(record.npz\), allowed: "):
        run.plot("exploration")


def test_a_record_is_written_while_the_run_goes_on_and_whole_when_its_block_is_left(tmp_path):
    from sixthsense.loop.run import run

    def scans() -> int:
        return sum(line.startswith(b'{"scan"') for line in (tmp_path / FILE).read_bytes().splitlines())

    with record_writer(tmp_path) as flush:

        def watch(tick, trace):
            if tick.stamp_ns < 1_000_000_000:
                flush(trace)
                assert scans() == len(trace.stamps_ns)

        trace = run(ss.preset(scene="rectangle", task="tour", max_time=2.0), watch)
        assert scans() < len(trace.stamps_ns)
    assert scans() == len(trace.stamps_ns)


@pytest.mark.parametrize("line", [b"", b"[]", b"{}", b"\xff\xfe", b"[" * 100_000, b'{"plan": [[1]]}', b'{"scan": "3"}'])
def test_a_line_that_says_nothing_is_named(folder, tmp_path, line):
    damaged = copied(folder, tmp_path / "damaged")
    lines = (damaged / FILE).read_bytes().splitlines()
    lines[11] = line
    (damaged / FILE).write_bytes(b"\n".join(lines) + b"\n")
    with pytest.raises(ss.InputError, match=r"record\.jsonl: line 12: found .*, allowed: a line of a run") as told:
        ss.load(damaged)
    assert "\n" not in str(told.value) and len(str(told.value)) < 600


@pytest.mark.parametrize(("text", "said"), [
    ("[1", "found no JSON"), ("[1]", "found no table"), ('{"outcome": 3}', "outcome: found 3, allowed: text"),
    ('{"plans": "x"}', "plans: found 'x', allowed: a number"), (f'{{"plans": {"9" * 999}}}', "allowed: a number"),
])  # fmt: skip
def test_damaged_metrics_are_named(folder, tmp_path, text, said):
    damaged = copied(folder, tmp_path / "damaged", "bag", "figures")
    (damaged / "metrics.json").write_text(text)
    with pytest.raises(ss.InputError, match=said):
        ss.load(damaged)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", [FILE, END_FILE])
def test_files_with_changed_bytes_are_read_or_named(folder, tmp_path, name, seed):
    rng = np.random.default_rng(seed)
    damaged = copied(folder, tmp_path / "damaged", "bag", "figures")
    content = bytearray((damaged / name).read_bytes())
    for place in rng.integers(len(content), size=3):
        content[place] = rng.integers(256)
    (damaged / name).write_bytes(content)
    try:
        ss.load(damaged)
    except ss.InputError as error:
        assert "\n" not in str(error) and name in str(error)


def test_a_folder_keeps_the_true_tracks_of_people_and_repeats_the_run(tmp_path):
    made = ss.run("apartment", world={"walkers": 2}, max_time=2.0, out=tmp_path / "run", progress=False)
    back = ss.load(tmp_path / "run")
    assert np.array_equal(back.trace.walkers, made.trace.walkers) and len(back.trace.walkers) == len(made.trace.truths)
    assert back.trace.touches == made.trace.touches == (0, 0) and back.metrics["touches_by_robot"] == 0
    assert back.trace.config.people
    again = ss.replay(tmp_path / "run", progress=False)
    assert np.array_equal(again.trace.trajectory, made.trace.trajectory)


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

    with watch.stage("sense"):
        receive()
    wait(clock, 7.0)
    with watch.stage("plan"):
        pass_time(clock, 0.004)
    watch.end_tick(is_keyframe=True)
    assert watch.totals["sense"] == pytest.approx(3.0)
    assert watch.rows == [pytest.approx({"sense": 3.0, "plan": 4.0})]
    assert watch.keyframe_ms() == pytest.approx([4.0])
