"""The landmark circle: its evidence, its figures, and (slow) the estimators' honesty on it."""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.motion import arc, arc_jacobian, rk4
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.circle import ODOMETRY_COV, RADIUS, Track, follow, landmarks, simulate

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
FILTERS = ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant")
CONSISTENT = FILTERS[1:]


@pytest.fixture
def circle(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import landmark_circle
    from harness import single_threaded

    with single_threaded():
        yield landmark_circle


@pytest.mark.parametrize(("distance", "turn"), [(0.25, 0.026), (-0.4, 1.1), (0.3, 0.0), (0.0, 0.7), (1.0, 1e-6)])
def test_the_jacobian_of_an_arc_agrees_with_finite_differences(distance, turn):
    h = 1e-6
    for column, (d, a) in enumerate(((h, 0.0), (0.0, h))):
        ahead, behind = (rk4(Pose(), distance + k * d, turn + k * a, 1.0, 1e-2).array() for k in (1, -1))
        np.testing.assert_allclose(arc_jacobian(distance, turn)[:, column], (ahead - behind) / (2 * h), atol=1e-8)


def test_twenty_landmarks_lie_three_metres_outside_the_driven_circle(circle):
    points = landmarks()
    assert points.shape == (20, 2)
    radius = 0.25 / math.radians(1.5)
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1] - radius), radius + 3.0)
    gaps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    np.testing.assert_allclose(gaps, gaps[0])


def test_the_true_path_is_the_circle_without_noise(circle):
    truth = simulate(0, 0, 480).truth
    np.testing.assert_allclose(np.hypot(truth[:, 0], truth[:, 1] - RADIUS), RADIUS)
    np.testing.assert_allclose(truth[239], np.zeros(3), atol=1e-9)  # once round in 240 steps
    first = Pose.from_array(truth[0])
    assert arc(first) == pytest.approx((0.25, math.radians(1.5)))
    step = rk4(Pose(), 0.25, math.radians(1.5), 1.0)
    assert math.dist(first.position, step.position) < 1e-9


def test_seed_and_run_determine_the_measurements(circle):
    one, again, other_run, other_seed = (simulate(*key, 40) for key in ((3, 1), (3, 1), (3, 2), (4, 1)))
    assert [o.motion for o in one.odometry] == [o.motion for o in again.odometry]
    assert all(
        np.array_equal(a[i].z, b[i].z) for a, b in zip(one.observations, again.observations, strict=True) for i in a
    )
    for other in (other_run, other_seed):
        assert one.odometry[0].motion != other.odometry[0].motion
    longer = simulate(3, 1, 50)
    assert [o.motion for o in longer.odometry[:40]] == [o.motion for o in one.odometry]


def test_the_noise_is_that_of_the_benchmark(circle):
    evidence, points = simulate(0, 0), landmarks()
    assert len(evidence.truth) == 2500
    driven = np.array([arc(o.motion) for o in evidence.odometry])
    assert driven.mean(axis=0) == pytest.approx((0.25, math.radians(1.5)), abs=4 * 0.0354 / 50)
    assert driven.std(axis=0) == pytest.approx((0.05 * 0.25 / math.sqrt(2), 0.05 * 0.25 * math.sqrt(8)), rel=0.06)
    errors = []
    for row, seen in zip(evidence.truth, evidence.observations, strict=True):
        z = Pose.from_array(row).inverse() @ points
        in_sight = (np.hypot(z[:, 0], z[:, 1]) > 1.0) & (np.hypot(z[:, 0], z[:, 1]) < 5.0)
        assert sorted(seen) == np.flatnonzero(in_sight).tolist() != []
        errors.extend(s.z - z[i] for i, s in seen.items())
    assert np.std(errors) == pytest.approx(0.1, rel=0.04)
    assert abs(np.mean(errors)) < 4 * 0.1 / math.sqrt(np.size(errors))


def test_the_covariance_of_odometry_has_rank_two_after_one_step_and_three_after_two(circle):
    evidence = simulate(0, 0, 3)
    for odometry in evidence.odometry:
        g = arc_jacobian(*arc(odometry.motion))
        np.testing.assert_allclose(odometry.cov, g @ ODOMETRY_COV @ g.T, atol=1e-15)
        assert np.linalg.matrix_rank(odometry.cov) == 2
    assert evidence.full_rank_from == 1
    for name in ESTIMATORS:
        nees = follow(name, evidence).nees3
        assert np.isnan(nees).tolist() == [True, False, False]


def test_every_estimator_follows_the_circle_with_little_noise(monkeypatch):
    for name in ("SIGMA_SPEED", "SIGMA_TURN_RATE", "SIGMA_POINT"):
        monkeypatch.setattr(f"sixthsense.testing.circle.{name}", 1e-6)
    for name in ("ODOMETRY_COV", "POINT_COV"):
        monkeypatch.setattr(f"sixthsense.testing.circle.{name}", 1e-12 * np.eye(2))
    evidence = simulate(0, 0, 300)
    for name in ESTIMATORS:
        track = follow(name, evidence)
        assert track.position_m.max() < 1e-4
        assert np.abs(track.heading).max() < 1e-5


def test_every_estimator_has_its_figures_and_its_ratios(circle, tmp_path):
    tracks = circle.all_runs(2, steps=25)
    figures = circle.circle_figures(tracks)
    fields = {"position_rmse_m", "heading_rmse_deg", "share_in_band", "step_ms"}
    nees = {"nees3", "nees3_invariant", "nees_heading"}
    keys = {name.replace("-", "_") for name in ESTIMATORS}
    wanted = {f"{key}.{field}" for key in keys for field in fields | nees | {f"{field}_se" for field in nees}}
    ratios = {f"{key}.position_rmse_by_ekf" for key in keys - {"ekf"}} | {"isam2.position_rmse_by_ekf_invariant"}
    assert set(figures) == wanted | ratios
    assert all(math.isfinite(value) for value in figures.values())
    assert [row[0] for row in circle.table(figures, ESTIMATORS)[1:6]] == list(ESTIMATORS)
    circle.save_figure(tmp_path / "circle.png", tracks)
    assert (tmp_path / "circle.png").is_file()


def test_figures_match_their_definitions(circle):
    def track(position, heading, nees):
        return Track(*(np.array(row) for row in (position, heading, nees, nees, nees)), 1.0)

    tracks = {
        "ekf": [track([3.0, 4.0], [0.1, -0.1], [math.nan, 2.0]), track([0.0, 5.0], [0.1, -0.1], [math.nan, 6.0])],
        "isam2": [track([1.0, 1.0], [0.2, 0.2], [math.nan, 3.0])] * 2,
    }
    figures = circle.circle_figures(tracks)
    assert figures["ekf.position_rmse_m"] == pytest.approx(math.sqrt((9 + 16 + 0 + 25) / 4))
    assert figures["ekf.heading_rmse_deg"] == pytest.approx(math.degrees(0.1))
    assert figures["ekf.nees3"] == pytest.approx(4.0)
    assert figures["ekf.nees3_se"] == pytest.approx(2.0)  # of two runs, 2 and 6
    assert figures["isam2.position_rmse_by_ekf"] == pytest.approx(1 / math.sqrt(12.5))
    assert "isam2.position_rmse_by_ekf_invariant" not in figures
    assert figures["ekf.share_in_band"] == figures["isam2.share_in_band"] == 1.0


def test_two_processes_give_the_results_of_one(circle):
    one, two = (circle.all_runs(3, ("ekf", "ekf-fej"), seed=5, jobs=jobs, steps=20) for jobs in (1, 2))
    for name, tracks in one.items():
        for a, b in zip(tracks, two[name], strict=True):
            assert np.array_equal(a.position_m, b.position_m) and np.array_equal(a.nees3, b.nees3, equal_nan=True)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_is_consistent_within_the_first_round(circle, name):
    """150 s, 20 runs. Runs are independent, the steps of one are not: the band is that of 20 runs, not of all steps."""
    runs = [follow(name, simulate(11, run, 150)) for run in range(20)]
    for field, dof in (("nees3", 3), ("nees3_invariant", 3), ("nees_heading", 1)):
        low, high = nees_band(20, dof, confidence=0.999)
        assert low < np.mean([np.nanmean(getattr(track, field)) for track in runs]) < high


@pytest.mark.parametrize("threshold", [0.1, 0.01])
def test_the_smoother_ends_near_the_invariant_filter(circle, threshold):
    """Both see all evidence and lose none of it to an invented heading: they differ by less than they err."""
    evidence = simulate(2, 0, 300)
    smoother = follow("isam2", evidence, ISAM2Config(relinearize_threshold=threshold))
    invariant = follow("ekf-invariant", evidence)
    gap = np.abs(wrap_angle(smoother.heading - invariant.heading))
    assert np.sqrt(np.mean(gap**2)) < 0.2 * np.sqrt(np.mean(invariant.heading**2))


@pytest.mark.parametrize(
    "options", [["--runs", "0"], ["--jobs", "0"], ["--seed", "-1"], ["--estimator", "ukf"], ["--runs", "many"]]
)
def test_an_invalid_option_is_refused_before_anything_runs(circle, options, monkeypatch, tmp_path, capsys):
    file = tmp_path / "figures.json"
    monkeypatch.setattr("sys.argv", ["landmark_circle.py", *options, "--json", str(file)])
    with pytest.raises(SystemExit) as stop:
        circle.main()
    assert stop.value.code == 2
    assert options[0] in capsys.readouterr().err
    assert not file.exists()


def test_the_command_writes_the_figures_of_the_given_estimators(circle, monkeypatch, tmp_path, capsys):
    file = tmp_path / "figures.json"
    monkeypatch.setattr(circle, "all_runs", partial(circle.all_runs, steps=10))
    monkeypatch.setattr("sys.argv", ["landmark_circle.py", "--runs", "2", "--jobs", "1", "--json", str(file),
                                     "--estimator", "ekf", "ekf-invariant"])  # fmt: skip
    circle.main()
    figures = json.loads(file.read_text())
    assert {key.split(".")[0] for key in figures} == {"ekf", "ekf_invariant"}
    assert "ekf-invariant" in capsys.readouterr().out


@pytest.mark.slow
def test_only_the_standard_filter_is_inconsistent(circle):
    """40 whole runs of the filters, each band that of 40 runs."""
    figures = circle.circle_figures(circle.all_runs(40, FILTERS))
    for field, dof in (("nees3", 3), ("nees3_invariant", 3), ("nees_heading", 1)):
        low, high = nees_band(40, dof, confidence=0.999)
        assert figures[f"ekf.{field}"] > high
        for name in CONSISTENT:
            assert low < figures[f"{name.replace('-', '_')}.{field}"] < high
    for name in CONSISTENT:
        assert figures[f"{name.replace('-', '_')}.position_rmse_by_ekf"] < 0.9
