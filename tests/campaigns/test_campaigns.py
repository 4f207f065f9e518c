import contextlib
import errno
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pyarrow.dataset
import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.campaigns import CampaignError, CampaignPlan, Rows, cluster, folder, worker
from sixthsense.campaigns.plan import AXES, config_hash, plan, ranges, seed_range, shared_fields
from sixthsense.evaluation.summary import mean_band, mean_interval, summary
from sixthsense.record import writing

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = ("--task", "tour", "--max-time", "4")
FIELDS = {"task": "tour", "max_time": 4.0}
IDENTITY = ["scene", "estimator", "front_end", "preset", "planner", "seed"]


def campaign_of(**changes):
    axes = {
        "scenes": ("rectangle",),
        "estimators": ("ekf",),
        "presets": ("default",),
        "planners": ("astar",),
        "seeds": (0, 1),
        "fields": FIELDS,
    }
    return CampaignPlan(**{**axes, **changes})


def row(key="a" * 16, seed=0, **more):
    fixed = {"scene": "rectangle", "estimator": "ekf", "preset": "default", "planner": "astar", "task": "tour"}
    return {"config_hash": key, "seed": seed, **fixed, "outcome": "tour ended", "version": "1", "host": "h", **more}


def run_command(*args: str) -> int:
    return cli.main(["campaign", *args])


def complaint(capsys, *args: str) -> str:
    before = sorted(Path().rglob("*"))
    assert run_command(*args) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("sixthsense: ") and "Traceback" not in err
    assert sorted(Path().rglob("*")) == before
    return err


# What a campaign is


@pytest.mark.parametrize(("word", "seeds"), [("0:100", range(100)), ("5", range(5, 6)), ("7:9", range(7, 9))])
def test_a_range_of_seeds_has_its_first_and_not_its_last(word, seeds):
    assert seed_range(word) == seeds


@pytest.mark.parametrize(
    "word", ["3:3", "5:2", "a:b", "", ":", "1:", ":4", "-3:4", "1.0:2", "1:2:3", "٣", "1_0", " 1", "0:" + 19 * "9"]
)
def test_a_range_of_seeds_that_is_empty_reversed_or_malformed_is_told(word):
    with pytest.raises(CampaignError, match=r"--seeds: found .*, allowed: FIRST:LAST"):
        seed_range(word)


def test_ranges_are_read_back_as_the_seeds_they_were_made_of():
    seeds = [9, 3, 4, 5, 0, 9]
    assert ranges(seeds) == ["0:1", "3:6", "9:10"]
    assert [seed for word in ranges(seeds) for seed in seed_range(word)] == [0, 3, 4, 5, 9]


def test_a_plan_is_the_product_of_its_axes_each_run_once_and_seed_by_seed():
    campaign = campaign_of(
        scenes=("rectangle", "block"), estimators=("ekf", "isam2"), presets=("default", "worn"), seeds=(4, 2)
    )
    runs = plan(campaign)
    assert len({tuple(run.axes().values()) for run in runs.values()}) == len(runs) == 16
    assert [run.seed for run in runs.values()] == 8 * [4] + 8 * [2]
    assert all(config_hash(run.config) == key for key, run in runs.items())
    worn = next(run.config for run in runs.values() if run.setting.preset == "worn")
    assert worn.world.wheel_scale_error == 0.02 and worn.max_time == 4.0


def test_the_hash_tells_every_field_apart_and_is_that_of_another_process():
    config = ss.preset(scene="rectangle", seed=3)
    changes = [{"seed": 4}, {"max_time": 10.0}, {"laser": {"beams": 90}}, {"goal": [1.0, 0.0]}, {"preset": "worn"}]
    assert len({config_hash(c) for c in (config, *(ss.merge(config, change) for change in changes))}) == 6
    code = "import sixthsense as ss; from sixthsense.campaigns.plan import AXES, config_hash as h; "
    code += "print(h(ss.preset(scene='rectangle', seed=3)))"
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=environment)
    assert found.stdout.strip() == config_hash(config)


def test_more_runs_than_a_folder_should_hold_are_refused():
    with pytest.raises(CampaignError, match="found 200000 runs, allowed: at most 100000"):
        plan(campaign_of(seeds=tuple(range(100_000)), estimators=("ekf", "isam2")))


def test_shared_fields_are_those_of_file_and_flags_without_the_axes():
    file = {"scene": "block", "seed": 3, "preset": "worn", "max-time": 9.0, "laser": {"beams": 90, "max_range": 5.0}}
    flags = {"estimator": "ekf", "laser": {"beams": 45}, "goal": None}
    assert shared_fields(file, flags) == {"max_time": 9.0, "laser": {"beams": 45, "max_range": 5.0}}


def test_shared_fields_have_their_present_names():
    with pytest.warns(FutureWarning, match="keyscans is now called keyframes"):
        assert shared_fields({"keyscans": {"turn-rad": 0.3}}) == {"keyframes": {"turn_rad": 0.3}}


# The table


def test_metrics_may_come_late_be_missing_or_be_texts_and_every_reader_sees_one_table():
    rows = Rows(Path("c"))
    rows.add(row("c" * 16, 2, ate_rmse_m=0.1))
    rows.add(row("b" * 16, 1, ate_rmse_m=np.float64(0.2), landmarks=np.int64(7), note="late"))
    rows.add(row("a" * 16, 0, outcome="error", error="ValueError: no"))
    Path("c/rows/.run-x.parquet.1").write_bytes(b"half a row")
    for frame in (rows.frame(), pd.read_parquet("c/rows"), pyarrow.dataset.dataset("c/rows").to_table().to_pandas()):
        by_seed = frame.set_index("seed").sort_index()
        assert by_seed["landmarks"].isna().tolist() == [True, False, True] and by_seed["landmarks"][1] == 7.0
        assert by_seed["note"][1] == "late" and by_seed["error"][0] == "ValueError: no"
        assert by_seed["ate_rmse_m"].dtype == np.float64 and by_seed["ate_rmse_m"][2] == 0.1
    Rows(Path("c")).add(row("d" * 16, 3, ate_rmse_m="a text where numbers were"))
    frame = rows.frame()
    assert len(frame) == 4 and np.isnan(frame["ate_rmse_m"][3]) and frame["seed"].dtype == np.int64


def test_a_run_is_in_the_table_once_however_often_its_row_is_written():
    for ate in (0.1, 0.2):
        Rows(Path("c")).add(row(ate_rmse_m=ate))
    assert Rows(Path("c")).frame()["ate_rmse_m"].tolist() == [0.2]


def test_a_full_disk_leaves_the_rows_before_it_readable_and_nothing_half_written(monkeypatch):
    rows = Rows(Path("c"))
    rows.add(row())
    before = sorted(Path("c").rglob("*"))

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(writing.os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device") as found:
        rows.add(row("b" * 16, 1))
    assert found.value.filename == f"c/rows/run-{'b' * 16}.parquet"
    assert sorted(Path("c").rglob("*")) == before and len(rows.frame()) == 1


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda c: None, "no such folder"),
        (lambda c: c.write_text(""), "a file"),
        (lambda c: c.mkdir(), "no campaign.toml in it"),
        (lambda c: (c.mkdir(), (c / "campaign.toml").write_text("[")), "is not TOML"),
        (lambda c: (c.mkdir(), (c / "campaign.toml").write_text("axes = 3")), "axes: found no such table"),
        (
            lambda c: (c.mkdir(), (c / "campaign.toml").write_text("[axes]\nscene = [3]\n[fields]\n[scenes]")),
            r"axes.scene: found \[3\]",
        ),
    ],
)
def test_a_folder_that_is_no_campaigns_is_told_in_one_line(make, found):
    make(Path("c"))
    with pytest.raises(ss.InputError, match=found) as error:
        ss.load_campaign("c")
    assert "\n" not in str(error.value)


def test_a_damaged_row_is_told_in_one_line(here):
    folder.save_folder(Path("c"), campaign_of(), None)
    assert len(ss.load_campaign("c")) == 0
    Rows(Path("c")).add(row())
    Path("c/rows/run-damaged.parquet").write_bytes(b"no parquet")
    with pytest.raises(ss.InputError, match=r"run-damaged\.parquet"):
        ss.load_campaign("c").frame()


def test_without_the_extra_one_line_says_how_to_install_it(monkeypatch, capsys):
    folder.save_folder(Path("c"), campaign_of(), None)
    for package in ("pandas", "pyarrow", "distributed"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            if package != "distributed":
                with pytest.raises(ss.InputError, match=r"pip install 'sixthsense\[campaign\]'"):
                    ss.load_campaign("c")
            if package != "pandas":
                said = complaint(capsys, "rectangle", *SHORT, "--seeds", "0:1", "--out", "new")
                assert said.startswith(f"sixthsense: {package}: cannot be imported")


def test_the_core_and_the_help_import_nothing_of_it():
    code = (
        "import sys, sixthsense.loop, sixthsense.figures.report, sixthsense.cli.run; from sixthsense.cli import main; "
    )
    code += "main(['--help']); assert not {'dask', 'distributed', 'pandas', 'pyarrow'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_means_have_students_interval_and_nees_the_band_of_so_many_runs():
    assert mean_interval(np.array([1.0, 2.0, 3.0])) == "2 ± 2.5"  # t = 4.303, s = 1, n = 3
    assert mean_interval(np.array([1.5])) == "1.5" and mean_interval(np.zeros(0)) == ""
    assert mean_band(np.full(50, 3.0)) == "3 in 2.36-3.72" and mean_band(np.full(50, 4.0)) == "4 not in 2.36-3.72"


def test_the_summary_has_a_line_per_setting_and_counts_how_its_runs_ended():
    rows = Rows(Path("c"))
    for seed in range(3):
        rows.add(row(f"{seed:016}", seed, ate_rmse_m=0.1 * seed, pose_nees_world_mean=3.0))
    rows.add({**row("f" * 16, 3), "outcome": "error"})
    rows.add({**row("e" * 16, 0), "estimator": "isam2", "scene": "/a/room.toml"})
    head, first, second = summary(rows.frame(), AXES)
    assert first[:6] == ["room", "isam2", "default", "astar", "1", ""]
    assert second[:6] == ["rectangle", "ekf", "default", "astar", "4", "0.1 ± 0.25"]
    assert second[-1] == "3 tour ended, 1 error" and len(head) == len(first) == len(second)


def test_the_band_of_a_group_is_that_of_the_effective_samples_of_its_runs():
    """Independent keyframes are that many samples; runs that are each off by a constant are one sample each."""
    rng, rows = np.random.default_rng(0), Rows(Path("c"))
    white = [rng.chisquare(3, 100) for _ in range(4)]
    constant = [np.full(100, mean) + 1e-3 * rng.standard_normal(100) for mean in (2.0, 2.6, 3.4, 4.0)]
    for seed, nees in enumerate(white):
        own = {"pose_nees_world_mean": float(nees.mean()), "pose_nees_effective_samples": 100.0}
        rows.add(row(f"{seed:016}", seed, **own))
    bands = [summary(rows.frame(), AXES, nees)[1][6].split()[-1] for nees in (white, constant, [*white[:3], None])]
    low, high = map(float, bands[0].split("-"))
    assert 2.7 < low < 3.0 < high < 3.3
    assert bands[1] == bands[2] == "1.10-5.83"  # of four samples


# What workers do


def test_a_run_that_raises_is_a_row_that_says_so_in_one_line(monkeypatch):
    def broken(config):
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr(worker, "_metrics", broken)
    found = worker.run_row(ss.preset(scene="rectangle", seed=5), ss.__version__)
    assert (found["outcome"], found["error"]) == ("error", "RuntimeError: first line second line")
    assert found["seed"] == 5 and found["config_hash"] == config_hash(ss.preset(scene="rectangle", seed=5))


def test_a_row_has_every_metric_of_the_run_and_what_the_campaign_varies():
    config = ss.preset(scene="rectangle", seed=5, **FIELDS)
    found = worker.run_row(config, ss.__version__)
    expected = ss.run(config).metrics
    assert set(expected) <= set(found) and found["ate_rmse_m"] == expected["ate_rmse_m"]
    assert {*IDENTITY, "config_hash", "host", "version", "run_time_s", "task"} <= set(found)


def test_a_worker_of_another_version_makes_no_run():
    with pytest.raises(worker.OtherVersionError, match=r"found version .* allowed: 0\.0\.1"):
        worker.run_row(ss.preset(), "0.0.1")


def test_a_lost_scheduler_is_told_and_a_lost_worker_is_a_row():
    from concurrent.futures import CancelledError

    from distributed.scheduler import KilledWorker

    run = next(iter(plan(campaign_of()).values()))

    def row_after(error):
        def result():
            raise error

        with cluster._scheduler_errors():
            return cluster._row(SimpleNamespace(result=result), run)

    found = row_after(KilledWorker("a task", None, 3))  # type: ignore[arg-type]
    assert (found["outcome"], found["error"]) == ("error", "KilledWorker: 4 workers died in this run")
    assert row_after(ImportError("no such\nmodule"))["error"] == "ImportError: no such module"
    for error in (CancelledError(), OSError("closed")):
        with pytest.raises(CampaignError, match="connection lost, the finished rows are kept"):
            row_after(error)


# The command


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("rectangle --out c", "--seeds: found nothing, allowed: FIRST:LAST"),
        ("rectangle --seeds --out c", "--seeds: found nothing"),
        ("rectangle --seeds 5:2 --out c", "--seeds: found '5:2', reversed"),
        ("rectangle --seeds 3:3 --out c", "--seeds: found '3:3', empty"),
        ("rectangle --seeds 0:3 a:b --out c", "--seeds: found 'a:b'"),
        ("rectangle --seeds=0:3 --seeds=4:5 --out c", "--seeds: found twice"),
        ("rectangle --seeds 0:2", "--out: found nothing"),
        ("rectangle --seed 3 --out c", "--seed: found for a campaign, allowed: --seeds"),
        ("--seeds 0:2 --out c rectangle", "scene: found 'rectangle' after an option, allowed: before all"),
        ("rectangle nowhere --seeds 0:2 --out c", "found 'nowhere', allowed: apartment, block"),
        (
            "rectangle --seeds 0:2 --out c --estimator ekf ukf",
            "--estimator: found 'ukf', did you mean ekf? allowed: ekf, ekf-fej",
        ),
        ("rectangle --seeds 0:2 --out c --preset best", "preset: found 'best', allowed: default, worn"),
        ("rectangle --seeds 0:2 --out c --planner prm", "--planner: found 'prm', allowed: astar"),
        (
            "rectangle --seeds 0:2 --out c --laser.beam 3",
            "--laser.beam: no such option, did you mean --laser.beams? allowed: --laser.beams",
        ),
        ("rectangle --seeds 0:2 --out c --laser.beams 1", "--laser.beams: found 1, allowed: 2 to 100000"),
        ("rectangle --seeds 0:2 --out c --goal 1 1 --task tour", "--goal: found with --task tour"),
        ("rectangle --seeds 0:2 --out c --goal 90 90", "goal: found (90, 90), outside the region"),
        ("rectangle --seeds 0:2 --out c --workers 0", "--workers: found 0, allowed: a whole number from 1"),
        ("rectangle --seeds 0:2 --out c --workers two", "--workers: found 'two', allowed: a whole number"),
        ("rectangle --seeds 0:2 --out c --workers 2 --scheduler tcp://127.0.0.1:1", "--workers: found with"),
        ("rectangle --seeds 0:2 --out c --scheduler tcp://127.0.0.1:1", "--scheduler: 'tcp://127.0.0.1:1' cannot be"),
        ("rectangle --seeds 0:2 --out c --scheduler nonsense", "--scheduler: 'nonsense' cannot be reached"),
        ("rectangle --seeds 0:2 --out c --config nowhere.toml", "nowhere.toml: cannot be read"),
    ],
)
def test_a_bad_command_line_ends_in_one_line_with_nothing_written(words, found, capsys):
    assert found in complaint(capsys, *words.split())


def test_what_stands_at_the_place_of_the_folder_and_is_none_is_told(capsys):
    Path("file").write_text("")
    Path("other").mkdir()
    Path("other/thing").write_text("")
    Path("run").mkdir()
    ss.save_config(ss.preset(), "run/config.toml")
    words = ("rectangle", *SHORT, "--seeds", "0:1", "--out")
    assert "file is a file" in complaint(capsys, *words, "file")
    assert "other is not a campaign folder" in complaint(capsys, *words, "other")
    assert "run is the folder of a run" in complaint(capsys, *words, "run")
    assert "file/c" in complaint(capsys, *words, "file/c")


def test_the_same_command_again_repeats_nothing_and_more_of_an_axis_makes_what_is_missing(nearby, capsys):
    words = ("rectangle", *SHORT, "--out", "c")
    assert run_command(*words, "--seeds", "0:3") == cli.DONE
    out = capsys.readouterr().out
    assert "3 tour ended" in out and "written to c/: 3 runs" in out
    stamps = {file: file.stat().st_mtime_ns for file in Path("c").rglob("*") if file.is_file()}
    assert run_command(*words, "--seeds", "0:3") == cli.DONE
    assert "all 3 runs are already in c/" in capsys.readouterr().err
    assert {file: file.stat().st_mtime_ns for file in Path("c").rglob("*") if file.is_file()} == stamps
    assert run_command(*words, "--seeds", "2:5", "--estimator", "ekf-invariant", "ekf") == cli.DONE
    assert "6 runs, 1 already in c/; 2 workers; dashboard http://" in capsys.readouterr().err
    frame = ss.load_campaign("c").frame()
    assert len(frame) == 8 and not frame.duplicated(IDENTITY).any() and not frame["config_hash"].duplicated().any()
    kept = [file for file in stamps if file.name.startswith("run-")]
    assert all(file.stat().st_mtime_ns == stamps[file] for file in kept)
    axes = tomllib.loads(Path("c/campaign.toml").read_text())["axes"]
    assert axes["seeds"] == ["0:5"] and axes["estimator"] == ["ekf-invariant", "ekf"]
    alone = ss.run(ss.preset(scene="rectangle", seed=1, **FIELDS)).metrics
    row = frame[(frame["estimator"] == "ekf-invariant") & (frame["seed"] == 1)]
    assert row["ate_rmse_m"].item() == alone["ate_rmse_m"]


def test_a_campaigns_folder_takes_no_other_configuration(nearby, capsys):
    words = ("rectangle", "--task", "tour", "--seeds", "0:1", "--out", "c", "--config", "some.toml")
    Path("some.toml").write_text("max-time = 4\nlaser.beams = 180\n")
    assert run_command(*words) == cli.DONE
    capsys.readouterr()
    assert "c is a campaign with laser.beams = 180, found 90" in complaint(capsys, *words, "--laser.beams", "90")
    assert "campaign with max_time = 4.0, found 5.0" in complaint(capsys, *words, "--max-time", "5")
    assert "robot.speed = the preset's, found 0.4" in complaint(capsys, *words, "--robot.speed", "0.4")
    # As a file or as flags, as a whole number or a real one: it is the same campaign.
    same = ("rectangle", *SHORT, "--laser.beams", "180", "--out", "c")
    assert run_command(*same, "--seeds", "0:1") == cli.DONE
    assert run_command(*same, "--seeds", "0:2") == cli.DONE


def test_a_row_of_another_version_of_the_defaults_is_told(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:1", "--out", "c")
    assert run_command(*words) == cli.DONE
    capsys.readouterr()
    monkeypatch.setitem(ss.config.PRESETS, "default", {"laser": {"beams": 90}})
    assert "c has the run rectangle ekf-invariant default astar 0 with another configuration" in complaint(
        capsys, *words
    )


def test_a_scene_that_has_changed_is_no_more_the_same_campaign(nearby, capsys):
    scene = Path("room.toml")
    text = "start = [0, 0, 0]\nradius = 0.2\ntour = [[1, 0], [0, 0]]\n[[polygons]]\npoints = {}\n"
    scene.write_text(text.format("[[-2, -2], [3, -2], [3, 2], [-2, 2]]"))
    words = ("room.toml", *SHORT, "--seeds", "0:1", "--out", "c")
    assert run_command(*words) == cli.DONE
    assert ss.load_campaign("c").frame()["scene"].tolist() == [str(scene.resolve())]
    capsys.readouterr()
    scene.write_text(text.format("[[-2, -2], [3, -2], [3, 2.5], [-2, 2]]"))
    assert "room.toml has changed since c was created" in complaint(capsys, *words)


def test_runs_that_fail_are_rows_and_are_made_again_only_when_asked(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:3", "--out", "c")
    works = worker._metrics

    def broken(config):
        if config.seed == 1:
            raise RuntimeError("lost a wheel")
        return works(config)

    with monkeypatch.context() as patch:
        patch.setattr(worker, "_metrics", broken)
        assert run_command(*words) == cli.FAILED
    said = "1 runs failed, first rectangle ekf-invariant default astar seed 1: RuntimeError: lost a wheel"
    assert said in capsys.readouterr().out
    assert ss.load_campaign("c").frame()["outcome"].tolist() == ["tour ended", "error", "tour ended"]
    assert run_command(*words) == cli.FAILED
    assert "all 3 runs are already in c/" in capsys.readouterr().err
    assert run_command(*words, "--retry-failed") == cli.DONE
    assert ss.load_campaign("c").frame()["outcome"].tolist() == 3 * ["tour ended"]
    assert ss.load_campaign("c").frame()["error"].isna().all()


def test_a_full_disk_ends_the_campaign_in_one_line_and_what_is_written_goes_on(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:4", "--out", "c")
    sync, calls = os.fsync, []

    def filling(file: int) -> None:
        calls.append(file)
        if len(calls) > 6:  # campaign.toml, the columns, two rows with their curves
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(file)

    with monkeypatch.context() as patch:
        patch.setattr(writing.os, "fsync", filling)
        assert run_command(*words) == cli.BAD_INPUT
    assert capsys.readouterr().err.splitlines()[-1].endswith(".parquet: No space left on device")
    assert len(ss.load_campaign("c")) == 2
    assert run_command(*words) == cli.DONE
    assert len(ss.load_campaign("c")) == 4


def test_ctrl_c_keeps_the_rows_and_exits_with_130(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:4", "--out", "c")
    add = Rows.add

    def add_and_press(rows, values):
        add(rows, values)
        os.kill(os.getpid(), signal.SIGINT)

    # What runs in the background of a shell ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(Rows, "add", add_and_press)
            assert run_command(*words) == cli.INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before)
    assert "interrupted, 1 of 4 runs are in c/, the same command makes the missing ones" in capsys.readouterr().err
    assert len(ss.load_campaign("c")) == 1
    assert run_command(*words) == cli.DONE


def test_workers_of_another_version_python_or_scene_are_told_before_anything_is_written(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:1", "--out", "c")
    with monkeypatch.context() as patch:
        patch.setattr(worker, "__version__", "9.9")
        assert "found version 9.9 of sixthsense, allowed: " in complaint(capsys, *words)
    with monkeypatch.context() as patch:
        patch.setattr(cluster, "python_minor", lambda: "3.2")
        assert "found Python 3.1" in complaint(capsys, *words)
    with monkeypatch.context() as patch:
        patch.setattr(worker, "scene_digest", lambda scene: "another")
        assert "found another scene rectangle than on this machine" in complaint(capsys, *words)
    with monkeypatch.context() as patch:
        patch.setattr(cluster, "describe", lambda scenes: 1 / 0)
        assert "found no usable sixthsense (ZeroDivisionError" in complaint(capsys, *words)


def test_a_scheduler_that_never_answers_is_given_up(capsys, monkeypatch):
    import socket

    monkeypatch.setattr(cluster, "REACH_S", 0.3)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        said = complaint(capsys, "rectangle", *SHORT, "--seeds", "0:1", "--out", "c", "--scheduler", address)
    assert "cannot be reached (no answer in 0.3 s)" in said


# Real processes


def program(*words: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "sixthsense.cli", "campaign", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


def makers(of: psutil.Process) -> list[psutil.Process]:
    return [child for child in of.children(recursive=True) if "spawn_main" in " ".join(child.cmdline())]


def test_a_worker_killed_in_the_middle_costs_no_row_and_none_is_there_twice():
    campaign = program("rectangle", "--task", "tour", "--max-time", "10", "--seeds", "0:8", "--out", "c")
    while campaign.poll() is None and len(list(Path().glob("c/rows/run-*"))) < 2:
        with contextlib.suppress(subprocess.TimeoutExpired):
            campaign.wait(0.05)
    makers(psutil.Process(campaign.pid))[0].kill()
    out, err = campaign.communicate()
    assert campaign.returncode == 0, err
    frame = ss.load_campaign("c").frame()
    assert len(frame) == 8 and not frame.duplicated(IDENTITY).any()
    assert set(frame["outcome"]) == {"tour ended"} and "8 tour ended" in out
    assert "Traceback" not in err and "dashboard http://127.0.0.1:" in err


@pytest.mark.slow
def test_a_run_that_kills_every_worker_is_a_row_and_takes_no_other_down(here):
    patch = """
import sixthsense.campaigns.worker as worker, os
whole = worker._metrics
worker._metrics = lambda config: os._exit(1) if config.seed == 1 else whole(config)
"""
    (here / "sitecustomize.py").write_text(patch)
    words = ("rectangle", *SHORT, "--seeds", "0:4", "--out", "c", "--workers", "2")
    path = os.pathsep.join([str(here), os.environ.get("PYTHONPATH", "")])
    campaign = program(*words, PYTHONPATH=path)
    _, err = campaign.communicate()
    assert campaign.returncode == 1 and "Traceback" not in err
    frame = ss.load_campaign("c").frame()
    assert frame["outcome"].tolist() == ["tour ended", "error", "tour ended", "tour ended"]
    assert frame["error"][1] == "KilledWorker: 4 workers died in this run"


@pytest.mark.slow
def test_a_scheduler_and_workers_started_by_hand_make_the_same_rows():
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = str(Path(sys.executable).with_name("dask"))
    lines = [[dask, "scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"]]
    lines += 2 * [[dask, "worker", address, "--no-dashboard"]]  # of as many threads as Dask likes
    with contextlib.ExitStack() as stack:
        for line in lines:
            started = stack.enter_context(subprocess.Popen(line, stderr=subprocess.PIPE, text=True))
            stack.callback(started.terminate)
            assert started.stderr is not None
            while "Scheduler at" not in (said := started.stderr.readline()) and "Registered to" not in said:
                assert started.poll() is None
        words = ("rectangle", *SHORT, "--seeds", "0:6")
        assert run_command(*words, "--out", "c", "--scheduler", address) == cli.DONE
    frame = ss.load_campaign("c").frame()
    assert len(frame) == 6
    for seed in range(6):
        alone = ss.run(ss.preset(scene="rectangle", seed=seed, **FIELDS)).metrics
        assert frame.loc[seed, "ate_rmse_m"] == alone["ate_rmse_m"]
