import contextlib
import csv
import importlib
import importlib.util
import io
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from sixthsense.cli import main
from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.loop import replay
from sixthsense.sources.logs.graph import read_graph
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.runfolder import read_run

MOTION = "ODOMETRY {} {} 1.0 0.1 0.2 1e-4 0 0 1e-4 0 1e-4\n"
SEEN = "LANDMARK {} {} {} {} 0.01 0 0.01\n"
SMALL = MOTION.format(0, 1) + SEEN.format(1, 5, 2.0, 1.0) + MOTION.format(1, 2) + SEEN.format(2, 5, 1.1, 0.6)


def graph(text: str, folder: Path, name: str = "some.graph") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def drive(poses: int = 30, order: int = 1) -> str:
    """A round of a circle past four landmarks, without noise; those of one pose in the order asked."""
    places = {1000: (3.0, 1.0), 1001: (0.0, 4.0), 1002: (-2.0, 2.0), 1003: (1.0, -2.0)}
    step, lines, pose = Pose(0.5, 0.05, 0.2), [], Pose()
    for k in range(poses):
        if k:
            x, y, turn = step.array().tolist()
            lines.append(f"ODOMETRY {k - 1} {k} {x!r} {y!r} {turn!r} 1e-4 0 0 4e-5 0 1e-4\n")
            pose = pose @ step
        for i, place in list(places.items())[::order]:
            x, y = (pose.inverse() @ np.array(place)).tolist()
            if math.hypot(x, y) < 4.0:
                lines.append(f"LANDMARK {k} {i} {x!r} {y!r} 0.01 0.001 0.02\n")
    return "".join(lines)


def test_poses_are_ticks_one_second_apart(tmp_path):
    log = read_graph(graph(SMALL, tmp_path))
    assert [tick.stamp_ns for tick in log.ticks] == [0, 10**9, 2 * 10**9]
    assert log.start == Pose() and log.ticks[2].odometry == Pose(1.0, 0.1, 0.2) @ Pose(1.0, 0.1, 0.2)
    assert [list(tick.observations) for tick in log.ticks] == [[], [5], [5]]
    assert log.ticks[1].observations[5].z.tolist() == [2.0, 1.0]
    assert np.array_equal(log.ticks[1].observations[5].cov, 0.01 * np.eye(2))
    assert log.ticks[0].increment_cov is None


def test_motion_tags_differ_in_the_order_and_the_meaning_of_their_numbers(tmp_path):
    own = np.array([[4.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 2.0]])
    information = np.linalg.inv(own)
    rows, toro = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), ((0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2))
    turn = np.eye(3)
    turn[:2, :2] = rotation(0.7)
    for tag, matrix, order in (("ODOMETRY", own, rows), ("EDGE_SE2", information, rows), ("EDGE2", information, toro)):
        numbers = " ".join(repr(float(matrix[place])) for place in order)
        log = read_graph(graph(f"{tag} 3 4 1 2 0.7 {numbers}\n", tmp_path))
        assert log.ticks[1].odometry == Pose(1, 2, 0.7)
        assert log.ticks[1].increment_cov == pytest.approx(turn @ own @ turn.T, abs=1e-9)


def test_landmark_tags_differ_in_the_meaning_of_their_numbers(tmp_path):
    cov = np.array([[0.3, 0.1], [0.1, 0.2]])
    (xx, xy), (_, yy) = np.linalg.inv(cov).tolist()
    lines = [
        "LANDMARK 1 10 3.0 4.0 0.3 0.1 0.2\n",
        f"EDGE_SE2_XY 1 11 3.0 4.0 {xx!r} {xy!r} {yy!r}\n",
        f"BR 1 12 {math.atan2(4.0, 3.0)!r} 5.0 0.02 0.1\n",
    ]
    seen = read_graph(graph(MOTION.format(0, 1) + "".join(lines), tmp_path)).ticks[1].observations
    assert list(seen) == [10, 11, 12]
    assert all(s.z == pytest.approx(np.array([3.0, 4.0]), abs=2e-3) for s in seen.values())
    assert seen[10].cov == pytest.approx(cov) and seen[11].cov == pytest.approx(cov)
    bearing, distance, polar = seen[12].bearing_range()
    assert (bearing, distance) == pytest.approx((math.atan2(4.0, 3.0), 5.0), abs=1e-6)
    assert polar == pytest.approx(np.diag([4e-4, 0.01]), rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("estimator", ["ekf", "ekf-invariant", "isam2"])
def test_a_replay_is_reproducible_for_any_order_of_observations(tmp_path, estimator):
    config = preset("victoria", estimator=estimator)
    log, turned = read_graph(graph(drive(), tmp_path, "a.txt")), read_graph(graph(drive(order=-1), tmp_path, "b.txt"))
    first, again, other = (replay(source, config) for source in (log, log, turned))
    assert np.array_equal(first.joint_cov, again.joint_cov)
    assert np.array_equal(np.array(first.estimates), np.array(again.estimates))
    assert np.array(other.estimates) == pytest.approx(np.array(first.estimates), abs=1e-6)
    assert len(first.estimates) == len(log.ticks) and set(first.final.ids.tolist()) == {1000, 1001, 1002, 1003}
    truth = np.array([tick.odometry.array() for tick in log.ticks])
    # The smoother takes out of a range what noise would have added, and these have none.
    assert np.array(first.estimates) == pytest.approx(truth, abs=1e-2 if estimator == "isam2" else 1e-4)


def command(*args: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, which has the kernels loaded."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(arg) for arg in args])
    return subprocess.CompletedProcess(args, code, out.getvalue(), err.getvalue())


def test_the_command_replays_a_graph_and_then_its_own_record_to_the_same_estimates(tmp_path):
    file = graph(drive(), tmp_path, "park.txt")
    first = command("replay", file, "--estimator", "isam2", "--out", tmp_path / "one")
    assert first.returncode == 0, first.stderr
    assert not (tmp_path / "one" / "truth.tum").exists() and not (tmp_path / "one" / "map.pgm").exists()
    with (tmp_path / "one" / "landmarks.csv").open() as rows:
        assert len(list(csv.DictReader(rows))) == 4
    assert json.loads((tmp_path / "one" / "metrics.json").read_text())["landmarks"] == 4
    again = command("replay", tmp_path / "one", "--out", tmp_path / "two")
    assert again.returncode == 0, again.stderr
    for name in ("estimate.tum", "smoothed.tum", "landmarks.csv"):
        assert (tmp_path / "two" / name).read_text() == (tmp_path / "one" / name).read_text()
    for a, b in zip(read_graph(file).ticks, read_run(tmp_path / "one", LaserConfig()).ticks, strict=True):
        assert (a.stamp_ns, a.odometry, list(a.observations)) == (b.stamp_ns, b.odometry, list(b.observations))
        assert (a.increment_cov is None) == (b.increment_cov is None)
        assert a.increment_cov is None or np.array_equal(a.increment_cov, b.increment_cov)
    report = command("report", tmp_path / "one", "--out", tmp_path / "report")
    assert report.returncode == 0, report.stderr


def victoria_park() -> Log:
    spec = importlib.util.find_spec("gtsam")
    assert spec is not None and spec.origin is not None
    return read_graph(Path(spec.origin).parent / "Data" / "victoria_park.txt")


def test_victoria_park_has_its_published_size():
    log = victoria_park()
    ids = [i for tick in log.ticks for i in tick.observations]
    assert (len(log.ticks), len(ids), len(set(ids))) == (6969, 3640, 151)
