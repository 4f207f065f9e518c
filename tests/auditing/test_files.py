"""Bags of ROS 1 and ROS 2, TUM files and folders of runs: the same poses have the same audit."""

import json
from itertools import starmap

import numpy as np
import pytest
from bags import Bag

import sixthsense as ss
from sixthsense.auditing.poses import poses_from
from sixthsense.cli import main
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.metrics import nees_world
from sixthsense.logs.text_lines import read_trajectory

N = 400
STAMPS_NS = 1_700_000_000_000_000_000 + 100_000_000 * np.arange(N)
HEADING = 0.05 * np.arange(N)
TRUTH = np.column_stack([3.0 * np.sin(HEADING), -3.0 * np.cos(HEADING), HEADING])
COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4
POSES = TRUTH + np.random.default_rng(0).multivariate_normal(np.zeros(3), COV, N)
EXPECTED = float(nees_world(POSES - TRUTH, np.broadcast_to(COV, (N, 3, 3))).mean())

PLANE = np.ix_((0, 1, 5), (0, 1, 5))
SPATIAL = np.zeros((6, 6))
SPATIAL[PLANE] = COV


def bag(path, topics, kind="mcap"):
    """Estimates as /pose and /odom, the truth as /truth."""
    with Bag(path, kind) as bag:
        for stamp, pose, truth in zip(STAMPS_NS.tolist(), starmap(Pose, POSES), starmap(Pose, TRUTH), strict=True):
            header, spread = bag.header(stamp, "map"), bag.spread(pose, cov=SPATIAL.ravel())
            if "/pose" in topics:
                bag.put("/pose", "geometry_msgs/PoseWithCovarianceStamped", stamp, header, spread)
            if "/odom" in topics:
                bag.odometry(stamp, pose, frame="map", child="base", cov=SPATIAL.ravel())
            if "/truth" in topics:
                bag.put("/truth", "geometry_msgs/PoseStamped", stamp, header, bag.pose(truth))
    return bag.path


def stamped(file, rows):
    """A file of numbers, a row per stamp."""
    stamps = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS_NS.tolist()]
    lines = [" ".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, rows, strict=True)]
    file.write_text("\n".join(["# a comment", *lines]) + "\n")
    return file


def tum(file, poses=TRUTH):
    half = 0.5 * poses[:, 2]
    return stamped(file, np.column_stack([poses[:, :2], np.zeros((N, 3)), np.sin(half), np.cos(half)]).tolist())


def covariances(file):
    return stamped(file, [COV[np.triu_indices(3)].tolist()] * N)


def nees(*arguments, **options):
    return ss.audit(*arguments, **options).findings.pose.nees


@pytest.mark.parametrize("topic", ["/pose", "/odom"])
def test_a_bag_of_ros_2_is_read_in_its_convention_with_the_truth_from_any_source(topic, tmp_path):
    file = bag(tmp_path / "b", [topic, "/truth"])
    assert nees(file, file, topic=topic, truth_topic="/truth") == pytest.approx(EXPECTED, rel=1e-9)
    assert nees(file, tum(tmp_path / "t.tum")) == pytest.approx(EXPECTED, rel=1e-9)
    assert nees(file, (1e-9 * STAMPS_NS, TRUTH)) == pytest.approx(EXPECTED, rel=1e-3)
    first = repr(ss.audit(file, file, truth_topic="/truth")).splitlines()[0]
    assert "world's axes" in first and "the convention of ROS" in first


def test_a_tum_file_has_its_covariances_beside_it(tmp_path):
    estimate, truth = tum(tmp_path / "e.tum", POSES), tum(tmp_path / "t.tum")
    assert nees(estimate, truth, covariance=covariances(tmp_path / "c.txt")) == pytest.approx(EXPECTED, rel=1e-9)


def test_the_folder_of_a_run_has_the_nees_of_its_metrics(tmp_path):
    run = ss.run("rectangle", task="tour", max_time=15.0, out=tmp_path / "run")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    folder, recorded = str(tmp_path / "run"), run.to_bag(tmp_path / "bag")
    for found in (
        ss.audit(run), ss.audit(folder), ss.audit(folder, folder),
        ss.audit(recorded, recorded, topic="/estimate", truth_topic="/truth"),
        ss.audit(recorded, folder, topic="/estimate"),
    ):  # fmt: skip
        assert found.findings.pose.nees == pytest.approx(metrics["pose_nees_world_mean"], abs=1e-9)
        assert found.findings.pose.samples == pytest.approx(metrics["pose_nees_effective_samples"])
        assert found.verdict.startswith(run.summary["consistency"])


def test_the_command_prints_writes_and_draws_and_may_require_consistency(tmp_path, capsys, complaint):
    file = bag(tmp_path / "b", ["/pose"])
    words = [str(file), "--truth", str(tum(tmp_path / "t.tum"))]
    out = ["--json", str(tmp_path / "a.json"), "--figure", str(tmp_path / "a.png")]
    assert main(["audit", *words, *out]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("covariance   in the world's axes")
    assert any(line.startswith("verdict      consistent: NEES ") for line in lines)
    assert json.loads((tmp_path / "a.json").read_text())["outcome"] == "consistent"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(["audit", *words, "--require", "consistent", *out, "--overwrite"]) == 0
    larger = tum(tmp_path / "e.tum", TRUTH + 2.0 * (POSES - TRUTH))
    wrong = [str(larger), *words[1:], "--covariance", str(covariances(tmp_path / "c"))]
    assert main(["audit", *wrong]) == 0
    assert main(["audit", *wrong, "--require", "consistent"]) == 1
    assert "overconfident: NEES " in capsys.readouterr().out
    assert "json: " in complaint("audit", *words, *out)
    with pytest.raises(ss.InputError, match="cannot be written"):
        ss.audit(*words[::2]).save(tmp_path / "a.json" / "audit.json")


def in_columns(file, head, sep, order):
    """The true poses in columns of x y z qx qy qz qw, -1 and theta, in this order, behind a stamp in nanoseconds."""
    half = 0.5 * TRUTH[:, 2]
    parts = np.column_stack([TRUTH[:, :2], np.zeros((N, 3)), np.sin(half), np.cos(half), -np.ones(N), TRUTH[:, 2]])
    rows = zip(STAMPS_NS.tolist(), parts[:, order].tolist(), strict=True)
    file.write_text("\n".join([*head, *(sep.join(map(repr, (stamp, *row))) for stamp, row in rows)]) + "\n")
    return file


EUROC = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"


@pytest.mark.parametrize(("head", "sep", "order"), [
    ([EUROC], ",", [0, 1, 2, 6, 3, 4, 5]),
    ([EUROC + ", v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]"], ",", [0, 1, 2, 6, 3, 4, 5, 7, 7]),
    (["time;x;y;yaw"], "; ", [0, 1, 8]),
    ([], " ", [0, 1, 8]),
    (["# stamp x y z qx qy qz qw", "timestamp,x,y,z,qx,qy,qz,qw"], ", ", [0, 1, 2, 3, 4, 5, 6]),
])  # fmt: skip
def test_a_trajectory_with_a_header_or_in_the_plane_has_the_same_poses(head, sep, order, tmp_path):
    notes = []
    file = in_columns(tmp_path / "t.csv", head, sep, order)
    stamps, poses = read_trajectory(file, notes)
    found, true = poses_from("found", stamps, poses).in_plane(), poses_from("true", STAMPS_NS, TRUTH)
    assert np.array_equal(stamps, STAMPS_NS)
    assert np.allclose(found.positions, true.positions) and found.turns.approx_equal(true.turns, 1e-9).all()
    with file.open("a") as lines:
        lines.write(f"{STAMPS_NS[-1] + 1}{sep}nan\n")
    with pytest.raises(InputError, match=f"line {N + 1 + len(head)}: found 2 fields"):
        read_trajectory(file, notes)


@pytest.mark.parametrize(
    ("head", "order"), [("time yaw x y", [8, 0, 1]), ("stamp,Y,X,Z,qx,qy,qz,qw", [1, 0, 2, 3, 4, 5, 6])]
)
def test_a_trajectory_whose_header_has_another_order_is_refused(head, order, tmp_path):
    with pytest.raises(InputError, match=r"line 2: found \d fields, allowed: 8 \(stamp x y z"):
        read_trajectory(in_columns(tmp_path / "t.csv", [head], " ", order), [])
