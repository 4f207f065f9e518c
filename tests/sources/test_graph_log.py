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
from sixthsense.evaluation.measure import measure
from sixthsense.loop import replay
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.graph import read_graph
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.runfolder import read_run

MOTION = "ODOMETRY {} {} 1.0 0.1 0.2 1e-4 0 0 1e-4 0 1e-4\n"
SEEN = "LANDMARK {} {} {} {} 0.01 0 0.01\n"
SMALL = MOTION.format(0, 1) + SEEN.format(1, 5, 2.0, 1.0) + MOTION.format(1, 2) + SEEN.format(2, 5, 1.1, 0.6)
LINES = SMALL.count("\n")


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


def error_of(text: str | bytes, folder: Path) -> str:
    file = folder / "bad.graph"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(LogError) as caught:
        read_graph(file)
    assert "\n" not in str(caught.value) and str(file) in str(caught.value)
    return str(caught.value)


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


def test_initial_values_comments_and_late_landmarks_are_accepted(tmp_path):
    text = "# a head\n\nVERTEX_SE2 0 0 0 0\nVERTEX2 1 9 9 9\nVERTEX_XY 7 1 1\n" + SEEN.format(0, 7, 1.0, 0.0)
    log = read_graph(graph(text + MOTION.format(0, 1) + MOTION.format(1, 2) + SEEN.format(1, 7, 2.0, 0.0), tmp_path))
    assert [list(tick.observations) for tick in log.ticks] == [[7], [7], []]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("EQUIV 1 2\n", "found tag 'EQUIV', allowed: ODOMETRY, EDGE2, EDGE_SE2, LANDMARK"),
        (MOTION.format(2, 1), "found pose 1 again, allowed: a new one"),
        (MOTION.format(2, 2), "found pose 2 again"),
        (MOTION.format(0, 3), "found an edge from pose 0 to 3, allowed: from the newest pose, 2"),
        (MOTION.format(2, 5), "found pose 5, allowed: an id that no landmark has"),
        (SEEN.format(3, 6, 1.0, 1.0), "found landmark 6 seen from pose 3, allowed: from a pose with an earlier edge"),
        (SEEN.format(2, 1, 1.0, 1.0), "found landmark 1, allowed: an id that no pose has"),
        (SEEN.format(2, 5, 1.0, 1.0), "found landmark 5 again from pose 2, allowed: once from each pose"),
        (SEEN.format(2, 6, "one", 1.0), "found 'one', allowed: a number"),
        (SEEN.format(2, 6, "nan", 1.0), "found 'nan', allowed: a finite number"),
        (SEEN.format(2, 6, 1e7, 1.0), "found 1e+07, allowed: up to 1e+06 either way"),
        (SEEN.format(2, -6, 1.0, 1.0), "found id '-6', allowed: a whole number, 0 to"),
        (SEEN.format(2, 3_000_000_000, 1.0, 1.0), "found id '3000000000'"),
        ("LANDMARK 2 6 1 1 1 2 1\n", "found 1 2 1, allowed: a covariance with eigenvalues above 0"),
        ("LANDMARK 2 6 1 1 0 0 0\n", "found 0 0 0, allowed: a covariance with eigenvalues above 0"),
        ("EDGE_SE2_XY 2 6 1 1 1 2 1\n", "found 1 2 1, allowed: an information matrix with eigenvalues above 0"),
        ("ODOMETRY 2 3 1 0 0 1 0 0 -1 0 1\n", "allowed: a covariance with eigenvalues at least 0"),
        ("EDGE2 2 3 1 0 0 1 0 0 1 0 1\n", "found 1 0 0 1 0 1, allowed: an information matrix"),
        ("ODOMETRY 2 3 1 0 0 1 0 0 1 0\n", "found ODOMETRY with 10 numbers, allowed: 11"),
        ("LANDMARK 2 6 1 1 1 0 1 1\n", "found LANDMARK with 8 numbers, allowed: 7"),
        ("BR 2 6 0.1 -1 0.1 0.1\n", "allowed: bearing range sigma sigma"),
        ("BR 2 6 0.1 1 0 0.1\n", "allowed: bearing range sigma sigma"),
        ("VERTEX2 8 1 1 1\nVERTEX2 8 1 1 1\n", "found pose 8 again"),
        ("VERTEX_XY 1 1 1\n", "found landmark 1, allowed: an id that no pose has"),
    ],
)
def test_a_bad_line_is_named_with_file_and_line(tmp_path, line, said):
    message = error_of(SMALL + line, tmp_path)
    assert f"line {LINES + line.count(chr(10))}: " in message and said in message
    assert len(message) < 300 + len(str(tmp_path))


def test_odometry_without_noise_is_allowed(tmp_path):
    log = read_graph(graph("ODOMETRY 0 1 1 0 0 0 0 0 0 0 0\n", tmp_path))
    assert not np.any(log.ticks[1].increment_cov)


def test_no_edge_random_bytes_and_a_missing_file_give_one_line(tmp_path):
    assert "found no edge between poses" in error_of("# nothing\n", tmp_path)
    for seed in range(10):
        error_of(np.random.default_rng(seed).bytes(3000), tmp_path)
    with pytest.raises(LogError, match="no such file"):
        open_log(tmp_path / "absent.g2o", LaserConfig())


@pytest.mark.parametrize("name", ["a.graph", "a.g2o", "a.toro", "a.txt", "a.TXT"])
def test_a_graph_is_recognised_by_its_name(tmp_path, name):
    assert len(open_log(graph(SMALL, tmp_path, name), LaserConfig()).ticks) == 3


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--assumed.floor-m", "1"], "--assumed.floor-m: found on a log that contains its own noise"),
        (["--grid.cell-m", "1"], "--grid.cell-m: found on a log that has landmarks and no scans"),
        (["--preset", "park"], "preset: found 'park', allowed: "),
    ],
)
def test_options_that_do_not_apply_to_a_graph_give_one_line_and_exit_code_2(tmp_path, words, said):
    done = command("replay", graph(SMALL, tmp_path), *words, "--out", tmp_path / "out")
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.partial").exists()


def test_an_invalid_graph_gives_one_line_and_exit_code_2(tmp_path):
    done = command("replay", graph(SMALL + "LOOP 1 2\n", tmp_path), "--out", tmp_path / "out")
    assert done.returncode == 2 and f"line {LINES + 1}: found tag 'LOOP'" in done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "out.partial").exists()


def victoria_park() -> Log:
    spec = importlib.util.find_spec("gtsam")
    assert spec is not None and spec.origin is not None
    return read_graph(Path(spec.origin).parent / "Data" / "victoria_park.txt")


def test_victoria_park_has_its_published_size():
    log = victoria_park()
    ids = [i for tick in log.ticks for i in tick.observations]
    assert (len(log.ticks), len(ids), len(set(ids))) == (6969, 3640, 151)


def test_the_columns_of_victoria_park_are_covariances():
    """Innovations are as large as they say: taken as information they would be two hundred times as large, or small."""
    figures = measure(replay(victoria_park(), preset("victoria", estimator="ekf-invariant")))
    assert 0.5 < figures["nis_mean_per_dof"] < 1.5
