"""A log with a truth in another frame and on another clock: one command."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.record.folder import reason_not_a_run

pytestmark = pytest.mark.usefixtures("compiled", "here")

T_MOCAP_MAP, AHEAD_S = ss.Pose(7.3, -2.1, 0.8), 0.31


def test_a_bag_is_audited_by_a_truth_in_another_frame_and_on_another_clock(here, capsys):
    words = "run rectangle --task tour --max-time 60 --front-end scan-matching --estimator isam2 --seed 3 --out drive"
    assert main(words.split()) == 0
    own = ss.load("drive").trace
    with (here / "mocap.tum").open("w", encoding="utf-8") as file:
        for stamp_ns, row in zip(own.stamps_ns, own.truths, strict=True):
            x, y, theta = (T_MOCAP_MAP @ ss.Pose.from_array(row)).array()
            file.write(f"{1e-9 * stamp_ns + AHEAD_S:.9f} {x} {y} 0 0 0 {np.sin(theta / 2)} {np.cos(theta / 2)}\n")
    capsys.readouterr()
    assert main(["export", "drive", "--bag"]) == 0
    capsys.readouterr()
    assert main(["replay", "drive/bag", "--truth", "mocap.tum", "--truth-offset", "1", "--out", "again"]) == 0
    out = capsys.readouterr().out
    assert "trajectory   ATE " in out and "verdict      " in out and reason_not_a_run(here / "again") == ""
    found = ss.load("again").trace.audit
    assert found["time_offset_s"] == [pytest.approx(AHEAD_S, abs=0.01)] and "ATE" in found["text"]
    assert found["trajectory"]["aligned_ate_m"] == pytest.approx(ss.load("drive").metrics["ate_rmse_m"], abs=0.01)
    assert main(["report", "again"]) == 0
    assert "Beside the truth" in (here / "again" / "figures" / "report.html").read_text(encoding="utf-8")


def test_what_is_wrong_with_a_truth_is_told_before_the_replay(here, capsys):
    assert main(["replay", "none.log", "--truth", "none.tum"]) == 2
    (here / "a.log").write_text("FLASER 2 1.0 1.2 0 0 0 0 0 0 0 host 0\n")
    assert main(["replay", "a.log", "--truth", "none.tum"]) == 2
    assert main(["replay", "a.log", "--truth-topic", "/mocap"]) == 2
    err = capsys.readouterr().err
    assert "none.tum: no such file" in err and "--truth-topic: found without --truth" in err
    assert not (here / "runs").exists()
