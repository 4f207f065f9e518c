import contextlib
import csv
import io
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from sixthsense.cli import main
from sixthsense.config import AssumedConfig, LaserConfig, merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.loop import replay
from sixthsense.sources.logs.mrclam import polar_observation, read_mrclam
from sixthsense.sources.logs.runfolder import read_run

ASSUMED = merge(AssumedConfig(), {"laser": {"range_m": 0.02, "bearing_rad": 0.01}})
BARCODES = {1: 5, 2: 14, 6: 63, 7: 81, 8: 7}
PLACES = {6: (4.0, 0.5), 7: (4.5, -0.5), 8: (5.0, 1.5)}
START = Pose(1.0, 0.2, 0.1)
SPEED, TURN_RATE = 0.2, 0.05


def rows(*values: object) -> str:
    return "# a head\n" + "".join(" ".join(map(str, row)) + "\n" for row in values)


def driven(seconds: float) -> Pose:
    """Where the robot truly is; it drives an arc."""
    turn = TURN_RATE * seconds
    radius = SPEED / TURN_RATE
    return START @ Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)


def folder(path: Path, robot: int = 3, steps: int = 40, order: int = 1) -> Path:
    """A small MRCLAM folder without noise; a measurement every half second, its landmarks in the order asked."""
    path.mkdir(exist_ok=True)
    times = [1000.0 + 0.1 * k for k in range(steps)]
    (path / "Barcodes.dat").write_text(rows(*BARCODES.items()))
    (path / "Landmark_Groundtruth.dat").write_text(rows(*((i, x, y, 0.0, 0.0) for i, (x, y) in PLACES.items())))
    (path / f"Robot{robot}_Odometry.dat").write_text(rows(*((f"{t:.3f}", SPEED, TURN_RATE) for t in times)))
    truth = rows(*((f"{t:.3f}", *driven(t - 1000.0).array()) for t in (*times, times[-1] + 0.1)))
    (path / f"Robot{robot}_Groundtruth.dat").write_text(truth)
    seen = []
    for t in [1000.25 + 0.5 * k for k in range(steps // 5 - 1)]:
        pose = driven(t - 1000.0)
        for i, place in list(PLACES.items())[::order]:
            x, y = pose.inverse() @ np.array(place)
            if x < 0.5 or abs(y) > 2.0 * x:
                continue
            seen.append((f"{t:.3f}", BARCODES[i], x, math.atan2(y, x)))
        seen.append((f"{t:.3f}", BARCODES[1], 2.0, 0.1))
    (path / f"Robot{robot}_Measurement.dat").write_text(rows(*seen))
    return path


def test_odometry_and_measurements_give_ticks_in_the_order_of_time(tmp_path):
    log = read_mrclam(folder(tmp_path), ASSUMED)
    stamps = [tick.stamp_ns for tick in log.ticks]
    assert len(stamps) == 40 + 7 and np.all(np.diff(stamps) > 0)
    assert [len(tick.observations) for tick in log.ticks if tick.observations] == [3] * 7
    assert all(tick.observations is not None and tick.truth is not None and tick.scan is None for tick in log.ticks)


def test_odometry_begins_at_the_first_true_pose_and_follows_the_rates(tmp_path):
    log = read_mrclam(folder(tmp_path), ASSUMED)
    for tick in log.ticks:
        assert tick.odometry.array() == pytest.approx(driven(1e-9 * tick.stamp_ns - 1000.0).array(), abs=1e-6)
        assert tick.truth.array() == pytest.approx(tick.odometry.array(), abs=1e-4)


def test_ids_are_subjects_robots_are_skipped_and_depths_become_distances(tmp_path):
    for tick in read_mrclam(folder(tmp_path), ASSUMED).ticks:
        for i, observation in (tick.observations or {}).items():
            assert (tick.odometry @ observation.z) == pytest.approx(np.array(PLACES[i]), abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_range_and_bearing_give_an_unbiased_observation_with_the_correct_covariance(seed):
    rng, many = np.random.default_rng(seed), 20_000
    r, b, sigma_r = 5.0, 0.7, 0.1
    for sigma_b in (0.02, 0.1):
        noisy = zip(r + sigma_r * rng.standard_normal(many), b + sigma_b * rng.standard_normal(many), strict=True)
        observations = [polar_observation(d, a, (sigma_r**2, sigma_b**2)) for d, a in noisy]
        errors = np.array([s.z for s in observations]) - r * np.array([math.cos(b), math.sin(b)])
        assert np.abs(errors.mean(axis=0)).max() < 4.0 * max(r * sigma_b, sigma_r) / math.sqrt(many)
        if sigma_b < 0.05:  # beyond that the ellipse is a banana
            nees = [e @ np.linalg.solve(s.cov, e) for e, s in zip(errors, observations, strict=True)]
            assert np.mean(nees) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_a_replay_is_reproducible_for_any_order_of_the_measurements(tmp_path, estimator):
    config = preset("mrclam", estimator=estimator)
    log, turned = read_mrclam(folder(tmp_path / "a"), ASSUMED), read_mrclam(folder(tmp_path / "b", order=-1), ASSUMED)
    first, again, other = (replay(source, config) for source in (log, log, turned))
    assert np.array_equal(first.joint_cov, again.joint_cov)
    assert np.array_equal(np.array(first.estimates), np.array(again.estimates))
    assert np.array(other.estimates) == pytest.approx(np.array(first.estimates), abs=1e-6)
    found = dict(zip(first.final.ids.tolist(), first.final.landmarks, strict=True))
    assert {i: place.tolist() for i, place in found.items()} == {i: pytest.approx(PLACES[i], abs=0.01) for i in PLACES}


def command(*args: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, which has the kernels loaded."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(arg) for arg in args])
    return subprocess.CompletedProcess(args, code, out.getvalue(), err.getvalue())


def test_the_command_replays_a_folder_and_then_its_own_record_to_the_same_estimates(tmp_path):
    folder(tmp_path / "set")
    first = command("replay", tmp_path / "set", "--robot", 3, "--out", tmp_path / "one")
    assert first.returncode == 0, first.stderr
    assert {"estimate.tum", "truth.tum", "landmarks.csv", "metrics.json"} <= {
        f.name for f in (tmp_path / "one").iterdir()
    }
    assert not (tmp_path / "one" / "map.pgm").exists()
    with (tmp_path / "one" / "landmarks.csv").open() as file:
        assert {int(row["id"]) for row in csv.DictReader(file)} == set(PLACES)
    again = command("replay", tmp_path / "one", "--out", tmp_path / "two")
    assert again.returncode == 0, again.stderr
    for name in ("estimate.tum", "truth.tum", "landmarks.csv"):
        assert (tmp_path / "two" / name).read_text() == (tmp_path / "one" / name).read_text()
    ours, back = read_mrclam(tmp_path / "set", preset("mrclam").assumed), read_run(tmp_path / "one", LaserConfig())
    for a, b in zip(ours.ticks, back.ticks, strict=True):
        assert (a.stamp_ns, a.odometry, a.truth, a.increment_cov) == (b.stamp_ns, b.odometry, b.truth, b.increment_cov)
        assert list(a.observations) == list(b.observations)
        for i, observation in a.observations.items():
            assert np.array_equal(observation.z, b.observations[i].z) and np.array_equal(
                observation.cov, b.observations[i].cov
            )
    report = command("report", tmp_path / "one", "--out", tmp_path / "report")
    assert report.returncode == 0, report.stderr
