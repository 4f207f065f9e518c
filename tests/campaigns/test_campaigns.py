import os
import signal
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.campaigns import plan as worker
from sixthsense.campaigns.folder import CampaignRows
from sixthsense.evaluation.curves import curves

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = ("--task", "tour", "--max-time", "4")
FIELDS = {"task": "tour", "max_time": 4.0}
IDENTITY = ["scene", "preset", "estimator", "front_end", "extractor", "place_search", "planner", "explorer", "seed"]


def run_command(*args: str) -> int:
    return cli.main(["campaign", *args])


def test_the_same_command_again_repeats_nothing_and_more_of_an_axis_makes_what_is_missing(nearby, capsys):
    words = ("rectangle", *SHORT, "--out", "c")
    assert run_command(*words, "--seeds", "0:3") == cli.DONE
    out = capsys.readouterr().out
    assert "3 tour ended" in out and "written to c/: 3 runs" in out
    rows = Path("c/rows.jsonl").read_text()
    stamps = {file: file.stat().st_mtime_ns for file in Path("c").rglob("*") if file.is_file()}
    assert run_command(*words, "--seeds", "0:3") == cli.DONE
    assert "all 3 runs are already in c/" in capsys.readouterr().err
    assert {file: file.stat().st_mtime_ns for file in Path("c").rglob("*") if file.is_file()} == stamps
    assert run_command(*words, "--seeds", "2:5", "--estimator", "ekf-invariant", "ekf") == cli.DONE
    assert "6 runs, 1 already in c/; 2 workers\n" in capsys.readouterr().err
    frame = ss.load_campaign("c").frame()
    assert len(frame) == 8 and not frame.duplicated(IDENTITY).any() and not frame["config_hash"].duplicated().any()
    assert Path("c/rows.jsonl").read_text().startswith(rows)
    assert frame.columns[: len(IDENTITY)].tolist() == IDENTITY and set(frame["front_end"]) == {"landmarks"}
    made = ss.campaign("rectangle", seeds=range(2), out="c", estimator="ekf-invariant", **FIELDS)
    assert isinstance(made, ss.Campaign) and "ekf-invariant" in repr(made) and "<table" in made._repr_html_()
    alone = ss.run(ss.preset(scene="rectangle", seed=1, **FIELDS))
    row = frame[(frame["estimator"] == "ekf-invariant") & (frame["seed"] == 1)]
    assert row["ate_rmse_m"].item() == alone.metrics["ate_rmse_m"]
    (sample,) = (one for one in made.samples("c") if (one.config.estimator, one.config.seed) == ("ekf-invariant", 1))
    assert sample.config == alone.trace.config
    np.testing.assert_allclose(sample.curves().position_m, curves(alone.trace).position_m, atol=1e-5)


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


def test_ctrl_c_keeps_the_rows_and_exits_with_130(nearby, capsys, monkeypatch):
    words = ("rectangle", *SHORT, "--seeds", "0:4", "--out", "c")
    add = CampaignRows.add

    def add_and_press(rows, values):
        add(rows, values)
        os.kill(os.getpid(), signal.SIGINT)

    # What runs in the background of a shell ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(CampaignRows, "add", add_and_press)
            assert run_command(*words) == cli.INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before)
    made = len(ss.load_campaign("c"))
    assert 1 <= made <= 2  # one that ended meanwhile is kept, too
    assert set(ss.load_campaign("c").frame()["outcome"]) == {"tour ended"}
    said = f"interrupted, {made} of 4 runs are in c/, the same command makes the missing ones"
    assert said in capsys.readouterr().err
    assert run_command(*words) == cli.DONE
