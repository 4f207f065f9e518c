import contextlib
import csv
import gzip
import io
import math
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from sixthsense.cli import main
from sixthsense.config import AssumedConfig, LaserConfig, merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.measure import measure
from sixthsense.loop import replay
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.mrclam import MrclamLog, polar_observation, read_mrclam
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


def error_of(path: Path, robot: int | None = None) -> str:
    with pytest.raises(LogError) as caught:
        read_mrclam(path, ASSUMED, robot)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def changed(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


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


def test_without_truth_odometry_begins_at_zero(tmp_path):
    (folder(tmp_path) / "Robot3_Groundtruth.dat").unlink()
    log = read_mrclam(tmp_path, ASSUMED)
    assert log.start == Pose() and all(tick.truth is None for tick in log.ticks)


def test_ids_are_subjects_robots_are_skipped_and_depths_become_distances(tmp_path):
    for tick in read_mrclam(folder(tmp_path), ASSUMED).ticks:
        for i, observation in (tick.observations or {}).items():
            assert (tick.odometry @ observation.z) == pytest.approx(np.array(PLACES[i]), abs=1e-3)


def test_depths_are_used_as_ranges_on_request(tmp_path):
    depth = read_mrclam(folder(tmp_path), ASSUMED)
    plain = read_mrclam(tmp_path, ASSUMED, as_depth=False)
    for a, b in zip(depth.ticks, plain.ticks, strict=True):
        for i in a.observations:
            bearing = math.atan2(*a.observations[i].z[::-1])
            assert np.hypot(*b.observations[i].z) == pytest.approx(np.hypot(*a.observations[i].z) * math.cos(bearing))


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


def test_bearing_and_range_of_an_observation_are_recovered():
    bearing, distance, cov = polar_observation(3.0, -0.4, (0.01, 0.0004)).bearing_range()
    assert (bearing, distance) == pytest.approx((-0.4, 3.0), abs=1e-6)
    assert cov == pytest.approx(np.diag([0.0004, 0.01]), rel=1e-3)


def test_files_may_be_compressed(tmp_path):
    plain = read_mrclam(folder(tmp_path), ASSUMED)
    for file in list(tmp_path.iterdir()):
        (tmp_path / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    packed = open_log(tmp_path, LaserConfig(), assumed=ASSUMED)
    assert isinstance(packed, MrclamLog) and set(packed.landmarks) == set(PLACES)
    assert [t.odometry for t in packed.ticks] == [t.odometry for t in plain.ticks]


def test_the_log_ends_where_truth_or_odometry_does(tmp_path):
    folder(tmp_path)
    lines = (tmp_path / "Robot3_Groundtruth.dat").read_text().splitlines(keepends=True)
    (tmp_path / "Robot3_Groundtruth.dat").write_text("".join(lines[6:31]))
    log = read_mrclam(tmp_path, ASSUMED)
    assert log.ticks[0].stamp_ns == 1000_500_000_000 and log.ticks[-1].stamp_ns == 1002_900_000_000
    assert log.start == log.ticks[0].truth


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


def test_a_log_without_scans_has_no_metrics_of_a_scene(tmp_path):
    figures = measure(replay(read_mrclam(folder(tmp_path), ASSUMED), preset("mrclam")))
    assert "coverage" not in figures and "goal_error_m" not in figures and figures["outcome"] == "log ended"


@pytest.mark.parametrize("name", ["Barcodes.dat", "Robot3_Odometry.dat", "Robot3_Measurement.dat"])
def test_a_missing_file_is_named(tmp_path, name):
    (folder(tmp_path) / name).unlink()
    assert (name if "Odometry" not in name else "RobotN_Odometry.dat") in error_of(tmp_path)


def test_a_robot_must_be_selected_among_several_and_must_exist(tmp_path):
    folder(tmp_path, robot=2)
    folder(tmp_path, robot=3)
    assert "found robots 2, 3, allowed: one, by --robot N" in error_of(tmp_path)
    assert "found no odometry of robot 5, allowed: 2, 3" in error_of(tmp_path, 5)
    assert len(read_mrclam(tmp_path, ASSUMED, 2).ticks) == 47


def test_rare_unknown_barcodes_are_skipped_and_frequent_ones_are_an_error(tmp_path):
    file = folder(tmp_path, steps=250) / "Robot3_Measurement.dat"
    changed(file, f" {BARCODES[6]} ", " 34 ")
    log = read_mrclam(tmp_path, ASSUMED)
    assert log.misread == 1
    changed(file, f" {BARCODES[7]} ", " 34 ")
    assert f"{file} line 2: found barcode '34', allowed: those of Barcodes.dat, 5, 7, 14, 63, 81" in error_of(tmp_path)


@pytest.mark.parametrize(
    ("name", "line", "said"),
    [
        (
            "Robot3_Measurement.dat",
            "1000.250 63 4.0 0.1",
            "line 2: found landmark 6 (barcode 63) again at the same stamp",
        ),
        ("Robot3_Measurement.dat", "1000.250 63.5 4.0 0.1", "found barcode '63.5', allowed: a whole number"),
        ("Robot3_Measurement.dat", "1000.250 63 -4.0 0.1", "found range '-4.0', allowed: 0.001 to 1000"),
        ("Robot3_Measurement.dat", "1000.250 63 4.0 1.6", "found bearing '1.6', allowed: -1.5 to 1.5"),
        ("Robot3_Measurement.dat", "1000.250 63 4.0", "found 3 columns, allowed: 4 (stamp, barcode, range, bearing)"),
        ("Robot3_Odometry.dat", "1000.0 fast 0", "found 'fast', allowed: a number"),
        ("Robot3_Odometry.dat", "1000.0 nan 0", "found 'nan', allowed: a finite number"),
        ("Robot3_Odometry.dat", "1000.0 1e5 0", "found forward speed '1e5', allowed: -1000 to 1000"),
        (
            "Robot3_Odometry.dat",
            "2000.0 0 0",
            "line 2: found stamp '1000.000', allowed: not before that of the previous",
        ),
        ("Robot3_Odometry.dat", "-1 0 0", "found stamp '-1', allowed: 0 to"),
        ("Robot3_Groundtruth.dat", "1000.0 1 2", "found 3 columns, allowed: 4 (stamp, x, y, orientation)"),
        ("Robot3_Groundtruth.dat", "1000.0 1e9 2 0", "found x '1e9', allowed: -1e+06 to 1e+06"),
        ("Barcodes.dat", "6 64", "found subject 6 with barcode 63, allowed: each once"),
        ("Barcodes.dat", "9 63", "found subject 6 with barcode 63, allowed: each once"),
        ("Landmark_Groundtruth.dat", "6 1 2 0 0", "found subject 6 again, allowed: each once"),
    ],
)
def test_a_bad_line_is_named_with_file_and_line(tmp_path, name, line, said):
    file = folder(tmp_path) / name
    changed(file, "# a head", line)
    message = error_of(tmp_path)
    assert f"{file} line " in message
    assert said in message


@pytest.mark.parametrize("name", ["Barcodes.dat", "Robot3_Odometry.dat", "Robot3_Measurement.dat"])
def test_random_bytes_and_empty_files_give_one_line(tmp_path, name):
    file = folder(tmp_path) / name
    for seed in range(10):
        file.write_bytes(np.random.default_rng(seed).bytes(2000))
        assert str(file) in error_of(tmp_path)
    file.write_text("# nothing\n")
    assert f"{file}: found no line of numbers" in error_of(tmp_path)


def test_truth_from_another_time_is_refused(tmp_path):
    (folder(tmp_path) / "Robot3_Groundtruth.dat").write_text(rows((1.0, 0, 0, 0), (2.0, 0, 0, 0)))
    assert "found truth at no stamp of the odometry" in error_of(tmp_path)


def test_zero_measurement_noise_is_refused(tmp_path):
    folder(tmp_path)
    with pytest.raises(LogError, match=r"assumed.laser.bearing_rad 0, allowed on ranges and bearings: above 0"):
        read_mrclam(tmp_path, merge(ASSUMED, {"laser": {"bearing_rad": 0.0}}))


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--robot", "4"], "found no odometry of robot 4, allowed: 3"),
        (["--laser.beams", "9"], "--laser.beams: found on a log that has landmarks and no scans"),
        (["--features.split.enabled", "false"], "--features.split: found on a log that has landmarks and no scans"),
        (["--topic", "/scan"], "--topic: found on a log that is not a ROS bag"),
        (["--assumed.laser.range-m", "0"], "assumed.laser.range_m 0"),
    ],
)
def test_options_that_do_not_apply_to_the_folder_give_one_line_and_exit_code_2(tmp_path, words, said):
    done = command("replay", folder(tmp_path / "set"), *words, "--out", tmp_path / "out")
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.partial").exists()


def test_the_option_robot_is_only_for_mrclam(tmp_path):
    (tmp_path / "g.txt").write_text("ODOMETRY 0 1 1 0 0 1e-4 0 0 1e-4 0 1e-4\n")
    done = command("replay", tmp_path / "g.txt", "--robot", 1)
    assert done.returncode == 2 and "--robot: found on a log that is not a MRCLAM folder" in done.stderr


@pytest.mark.skipif("SIXTHSENSE_DATA" not in os.environ, reason="SIXTHSENSE_DATA=FOLDER with mrclam6/ adds real data")
def test_the_real_log_is_read_and_the_invariant_filter_stays_near_vicon():
    log = read_mrclam(Path(os.environ["SIXTHSENSE_DATA"]) / "mrclam6", preset("mrclam").assumed, 3)
    assert (len(log.ticks), log.misread, len(log.landmarks)) == (63235, 2, 15)
    assert sum(bool(tick.observations) for tick in log.ticks) == 2279
    # The wheels of this robot, a fit to intervals of 10 s against Vicon: no preset knows them.
    wheels_of_robot_3 = {"wheel_scale_error": -0.056, "drift_rad_per_m": -0.058}
    trace = replay(log, preset("mrclam", estimator="ekf-invariant", assumed=wheels_of_robot_3))
    gap = np.array(trace.estimates) - np.array(trace.truths)
    wheels = np.array(trace.odometry) - np.array(trace.truths)
    assert math.sqrt(np.mean(gap[:, :2] ** 2)) < 0.15 < 2.0 < math.sqrt(np.mean(wheels[:, :2] ** 2))
