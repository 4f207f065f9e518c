"""Campaigns from Python: `ss.campaign`, comparisons of what it returns, and reports."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import sixthsense as ss
from sixthsense.campaigns import CampaignPlan, Rows, report, worker
from sixthsense.campaigns.folder import save_folder
from sixthsense.campaigns.plan import plan
from sixthsense.cli import main
from sixthsense.evaluation.curves import Curves

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = {"task": "tour", "max_time": 4.0}


@pytest.fixture
def done() -> ss.Campaign:
    """A folder as of two estimators over three seeds in two scenes, whose errors are made up."""
    planned = CampaignPlan(("block", "loop"), ("ekf", "isam2"), ("worn",), ("astar",), (0, 1, 2), SHORT)
    save_folder(Path("mc"), planned, None)
    for key, run in plan(planned).items():
        error = np.full(20, 1.0 + run.seed + 10.0 * (run.setting.estimator == "isam2"))
        time_s = np.arange(20.0)
        row = {**worker.row_of(run.config), "config_hash": key, "outcome": "tour ended", "ate_rmse_m": error[0]}
        row |= {f"rpe_{part}_{m}m": error[0] * m for part in ("trans_m", "rot_deg") for m in (1, 2, 5, 10)}
        curves = Curves(time_s, 0.5 * time_s, error, 0.1 * error, np.full(20, 3.0))
        Rows(Path("mc")).add({**row, "pose_nees_world_mean": 3.0, worker.CURVES: curves})
    return ss.load_campaign("mc")


def test_a_campaign_is_run_from_python_and_resumed_with_more_estimators(nearby):
    first = ss.campaign("rectangle", seeds=range(2), out="c", estimator="ekf", **SHORT)
    assert isinstance(first, ss.Campaign) and len(first) == 2
    kept = {file: file.stat().st_mtime_ns for file in Path("c").rglob("run-*")}
    both = ss.campaign("rectangle", seeds=range(2), out="c", estimator=["ekf", "isam2"], **SHORT)
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in kept.items())
    frame = both.frame()
    assert list(frame.columns)[:6] == ["scene", "estimator", "front_end", "preset", "planner", "seed"]
    assert frame["estimator"].tolist() == ["ekf", "ekf", "isam2", "isam2"] and set(frame["front_end"]) == {"landmarks"}
    alone = ss.run("rectangle", estimator="isam2", seed=1, **SHORT)
    assert frame["ate_rmse_m"][3] == alone.metrics["ate_rmse_m"]
    assert ss.load_campaign("c").frame().equals(frame)
    (sample,) = (one for one in both.samples("c") if (one.config.estimator, one.config.seed) == ("isam2", 1))
    assert sample.config == alone.trace.config
    np.testing.assert_allclose(sample.curves().time_s, alone.trajectory.frame()["time_s"], atol=1e-5)
    assert "isam2" in repr(both) and "<table>" in both._repr_html_()
    words = "campaign rectangle --seeds 0:2 --task tour --max-time 4 --estimator ekf --out c"
    assert main(words.split()) == 0


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"seeds": 3}, "seeds: found 3, allowed: whole numbers of at least 0, such as range"),
        ({"seeds": "0:3"}, "seeds: found '0:3', allowed"),
        ({"seeds": []}, "seeds: found none, allowed"),
        ({"seeds": [1.5]}, "seeds: found 1.5, allowed"),
        ({"seeds": [-1]}, "seeds: found -1, allowed"),
        ({"scenes": []}, "scenes: found \\[\\], allowed: names or files"),
        ({"scenes": "rectangel"}, "found 'rectangel', did you mean rectangle. allowed: "),
        ({"estimator": ["ekf", "ukf"]}, "estimator: found 'ukf', did you mean ekf. allowed: ekf"),
        ({"estimator": lambda start, cov: None}, "estimator: found .*, which the workers do not know, allowed: ekf"),
        ({"estimator": []}, "estimator: found \\[\\], allowed: one value or several"),
        ({"estimatr": "ekf"}, "estimatr: no such field, .*did you mean estimator"),
        ({"laser": {"beams": 1}}, "laser.beams: found 1, allowed: 2 to"),
        ({"seed": 3}, "seed: found for a campaign, allowed: seeds"),
        ({"goal": (1.0, 1.0), "task": "tour"}, "goal: found with task tour, allowed: with task goal"),
        ({"workers": 0}, "workers: found 0, allowed: a whole number from 1"),
        ({"out": "file"}, "out: file is a file, allowed: a new or empty folder"),
    ],
)
def test_what_will_not_do_is_told_in_one_line_that_begins_with_its_name(change, found):
    Path("file").write_text("")
    with pytest.raises(ss.InputError, match=f"^(scene: )?{found}") as error:
        ss.campaign(**{"scenes": "rectangle", "seeds": range(2), "out": "c", **change})
    assert "\n" not in str(error.value) and not Path("c").exists()


def test_a_campaign_is_compared_in_groups_over_its_seeds(done):
    picture = ss.compare(done).plot("error", by=["scene", "estimator"])
    lines = picture.axes[0].get_lines()
    assert [line.get_label() for line in lines] == [
        "block · ekf, 3 runs", "block · isam2, 3 runs", "loop · ekf, 3 runs", "loop · isam2, 3 runs"
    ]  # fmt: skip
    assert [line.get_ydata()[0] for line in lines] == [2.0, 12.0, 2.0, 12.0]
    together = ss.compare({"study": done, "alone": ss.run("rectangle", estimator="ekf", **SHORT)})
    assert len(together) == 13 and len(together.runs) == 1
    by_name = together.plot("error", by="run")
    assert [line.get_label() for line in by_name.axes[0].get_lines()] == ["study, 12 runs", "alone"]
    frame = together.frame()
    assert frame.loc["study"].groupby("estimator")["ate_rmse_m"].median().tolist() == [2.0, 12.0]
    assert "isam2" in repr(together) and "<b>13 runs</b>" in together._repr_html_()


def test_a_campaigns_folder_is_no_run(done):
    with pytest.raises(ss.InputError, match=r"found the folder of a campaign, mc, allowed: ss.load_campaign\('mc'\)"):
        ss.compare(["mc"])
    with pytest.raises(ss.InputError, match=r"found the folder of a campaign, mc, allowed: ss\.load_campaign"):
        ss.compare("mc")
    with pytest.raises(ss.InputError, match="mc: found the folder of a campaign, allowed: the folder of a run"):
        ss.load("mc")


def test_a_campaign_of_an_earlier_version_has_its_front_end_and_no_curves(done):
    for file in Path("mc/curves").iterdir():
        file.unlink()
    old = ss.load_campaign("mc")
    assert set(old.frame()["front_end"]) == {"landmarks"}
    with pytest.raises(ss.InputError, match="error: found no run whose errors are known"):
        ss.compare(old).plot("error")
    assert ss.compare(old).plot("rpe", by="estimator").axes


def test_what_was_a_frame_still_is_with_a_warning(done):
    with pytest.warns(DeprecationWarning, match=r"use campaign.frame\(\)"):
        assert len(done["ate_rmse_m"]) == len(done) == 12
    with pytest.warns(DeprecationWarning, match=r"use campaign.frame\(\)"):
        assert done.groupby("estimator")["seed"].count().tolist() == [6, 6]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not hasattr(done, "_repr_png_")


def test_the_report_on_a_campaign_has_figures_for_each_scene_a_table_and_a_page(done, capsys, monkeypatch):
    monkeypatch.setattr(report, "save", lambda figure, file: figure.savefig(file, dpi=20))
    assert main(["report", "mc"]) == 0
    out = capsys.readouterr().out
    kinds, scenes = ("error", "error-distance", "rpe", "nees"), ("block", "loop")
    names = {f"{kind}-{scene}.png" for kind in kinds for scene in scenes}
    assert {file.name for file in Path("mc/figures").iterdir()} == names | {"metrics.csv", "report.html"}
    assert "3 tour ended" in out and "written to mc/figures/: " in out
    page = Path("mc/figures/report.html").read_text()
    assert page.count("<img") == 8 and "Metrics in loop" in page
    assert "sixthsense campaign block loop --seeds 0:3 --estimator ekf isam2 --preset worn" in page
    assert "12 (11.2 to 12.8)" in page  # ATE of isam2: 11, 12, 13


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("report mcc", "mcc: found no such folder, allowed: the folder of a run or of a campaign; did you mean mc?"),
        ("report rows", "rows: found no config.toml in it, allowed: the folder of a run or of a campaign"),
        ("report mc rows", "run: found a campaign among 2 folders, allowed: one campaign alone, or runs"),
        ("report mc --animate", "--animate: found with a campaign, allowed: with one run"),
        ("report empty", "empty: found no runs, allowed: a campaign with at least one"),
        ("report damaged", "damaged/campaign.toml: axes: found no such table, allowed: the folder of a campaign"),
    ],
)
def test_what_cannot_be_reported_on_is_told_in_one_line(done, words, found, capsys):
    Path("rows").mkdir()
    for name in ("empty", "damaged"):
        Path(name).mkdir()
    Path("empty/campaign.toml").write_bytes(Path("mc/campaign.toml").read_bytes())
    Path("damaged/campaign.toml").write_text("")
    assert main(words.split()) == 2
    assert capsys.readouterr().err == f"sixthsense: {found}\n"


@pytest.mark.slow
def test_a_script_without_a_guard_runs_once():
    """Its workers do not run it again, as processes that are spawned do."""
    Path("study.py").write_text(
        "import sixthsense as ss\nprint('begun')\n"
        "done = ss.campaign('rectangle', seeds=range(2), workers=1, out='c', task='tour', max_time=2)\n"
        "print(len(done), 'runs', __file__)\n"
    )
    ran = subprocess.run(
        [sys.executable, "study.py"], capture_output=True, text=True, timeout=300, check=False,
        env=os.environ | {"MPLCONFIGDIR": matplotlib.get_cachedir()},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("begun") == 1 and "2 runs" in ran.stdout and "study.py" in ran.stdout
