"""Campaigns from Python: `ss.campaign`, comparisons of what it returns, and reports."""

from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.campaigns import Rows, report, worker
from sixthsense.campaigns.folder import save_folder
from sixthsense.campaigns.plan import campaign_of, plan
from sixthsense.cli import main
from sixthsense.evaluation.curves import Curves

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = {"task": "tour", "max_time": 4.0}


@pytest.fixture
def done() -> ss.Campaign:
    """A folder as of two estimators over three seeds in two scenes, whose errors are made up."""
    axes = {"scene": ["block", "loop"], "estimator": ["ekf", "isam2"], "preset": ["worn"], "planner": ["astar"]}
    planned = campaign_of(axes, range(3), SHORT)
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


def test_a_campaign_of_an_earlier_version_has_its_front_end_and_no_curves(done):
    for file in Path("mc/curves").iterdir():
        file.unlink()
    old = ss.load_campaign("mc")
    assert set(old.frame()["front_end"]) == {"landmarks"}
    with pytest.raises(ss.InputError, match="error: found no run whose errors are known"):
        ss.compare(old).plot("error")
    assert ss.compare(old).plot("rpe", by="estimator").axes


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
