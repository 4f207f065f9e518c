"""A log with a truth in another frame and on another clock: one command."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.record.folder import reason_not_a_run

pytestmark = pytest.mark.usefixtures("compiled", "here")

T_MOCAP_MAP, AHEAD_S = ss.Pose(7.3, -2.1, 0.8), 0.31


def evo_rmse(found, truth):
    """RMSE of the position after an alignment by evo, of (N, 3) poses."""
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    def trajectory(poses):
        half, zero = 0.5 * poses[:, 2], np.zeros(len(poses))
        return PoseTrajectory3D(
            np.column_stack([poses[:, :2], zero]), np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
            np.arange(float(len(poses))),
        )  # fmt: skip

    reference, estimate = trajectory(truth), trajectory(found)
    estimate.align(reference)
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data((reference, estimate))
    return metric.get_statistic(metrics.StatisticsType.rmse)


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
    run = ss.load("again").trace
    truths = dict(zip(own.stamps_ns, own.truths, strict=True))
    keys = [k for k, stamp in enumerate(run.key_stamps_ns) if stamp in truths]
    poses = np.array([run.key_estimates[k].pose.array() for k in keys])
    expected = evo_rmse(poses, np.array([truths[run.key_stamps_ns[k]] for k in keys]))
    assert found["trajectory"]["aligned_ate_m"] == pytest.approx(expected, rel=0.1)  # by an offset of some ms
    exact = ss.audit((1e-9 * np.array(run.key_stamps_ns)[keys], poses, np.array([np.eye(3)] * len(keys))),
                     (1e-9 * np.array(own.stamps_ns), np.array(own.truths)))  # fmt: skip
    assert exact.trajectory.aligned_ate_m == pytest.approx(expected, abs=1e-6)
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
