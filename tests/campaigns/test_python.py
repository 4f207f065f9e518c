"""Campaigns from Python: `ss.campaign`, and the frame of what it returns."""

from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.cli import main

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = {"task": "tour", "max_time": 4.0}


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
