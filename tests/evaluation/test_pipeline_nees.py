"""Tours in closed loop with unknown association: is the pose's covariance honest, and are the matches right?

What the first scans get wrong stays in the map, and so in every pose: the keyframes of a run are not independent
samples. Runs are independent, and the band follows from the effective number of samples of all runs together, which
their differences limit. It is wide for few runs; `test_power.py` has many short ones.
"""

import dataclasses
import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from sixthsense.evaluation.effective import band_of_runs, effective_samples

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"

SEEDS = range(1000, 1011)


@pytest.fixture
def tours(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("tours")


@pytest.fixture
def pipeline(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("pipeline_nees")


def band(rows, confidence=0.99):
    nees = [np.array([value for value in row["nees3"] if value is not None]) for row in rows]
    return band_of_runs(effective_samples(nees), len(nees), confidence)


def configs(tours, estimator, seconds, seeds):
    config = tours.tour("apartment", estimator, "default", seconds, features={"landmarks": "both"})
    return [dataclasses.replace(config, seed=seed) for seed in seeds]


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["isam2", "ekf-invariant"])
def test_tours_of_the_apartment_are_consistent_and_well_matched(tours, pipeline, estimator):
    found = tours.rows(configs(tours, estimator, 400.0, SEEDS), jobs=1)
    figures = pipeline.pipeline_figures(found)
    assert figures["tour_ended"] == len(SEEDS)
    low, high = band(found)
    assert low < figures["nees3"] < high
    assert low < figures["nees3_invariant"] < high
    assert 0.9 < figures["nis_per_dof"] < 1.1
    assert figures["wrong_per_1000"] < 0.5
    assert figures["spanning_per_1000"] < 0.5
    assert figures["left_out_per_1000"] < 0.5
    assert figures["discarded_share"] < 0.01
    assert figures["unexplained_per_1000"] < 2.0
    assert figures["ate_max_m"] < 0.03


def test_a_row_has_the_figures_of_a_run_and_is_reused(tours, pipeline, tmp_path, monkeypatch):
    short = configs(tours, "ekf-invariant", 12.0, range(2))
    found = tours.rows(short, jobs=1, folder=tmp_path)
    assert len(list(tmp_path.glob("*.json"))) == 2
    for row in found:
        assert row["outcome"] == "tour ended"
        assert row["wrong"] == row["spanning"] == row["left_out"] == 0
        assert 0.0 <= row["discarded_share"] < 0.05
        assert row["observations"] > 100
        assert len(row["nees3"]) == row["keyframes"]
        assert json.loads(json.dumps(row)) == row
    monkeypatch.setattr(tours, "make_row", lambda config: pytest.fail("made again"))
    assert tours.rows(short, jobs=1, folder=tmp_path) == found
    figures = pipeline.pipeline_figures(found)
    assert figures["runs"] == 2
    assert all(np.isfinite(value) for value in figures.values())
    assert len(pipeline.per_run(found)) == 3
    own = {f"ekf_invariant.{key}": value for key, value in figures.items()}
    lines = pipeline.table(own, ["ekf-invariant"])
    assert {len(cells) for cells in lines} == {len(pipeline.COLUMNS) + 1}


def test_the_mean_over_runs_skips_missing_values(tours):
    rows = [{"nees3": [None, 2.0, 4.0]}, {"nees3": [None, 4.0]}]
    np.testing.assert_allclose(tours.over_runs(rows, "nees3"), [np.nan, 3.0, 4.0])
    assert tours.nees_of(rows[0]) == 3.0


def test_the_mean_nees_of_errors_drawn_from_the_covariance_is_the_dimension(tours):
    rng = np.random.default_rng(2)
    cov = np.array([[4.0, 1.0, 0.01], [1.0, 2.0, 0.02], [0.01, 0.02, 0.001]]) * 1e-4
    error = rng.multivariate_normal(np.zeros(3), cov, 20_000)
    truths = np.column_stack([np.full(20_000, 3.0), np.full(20_000, -2.0), np.full(20_000, 3.1)])
    series = tours.keyframe_nees(truths + error, truths, np.broadcast_to(cov, (20_000, 3, 3)))
    for name, dof in (("nees3", 3), ("nees3_invariant", 3), ("nees_position", 2), ("nees_heading", 1)):
        assert np.mean(series[name]) == pytest.approx(dof, abs=5.0 * np.sqrt(2.0 * dof / 20_000))


def test_a_partial_configuration_overrides_the_preset(tours, tmp_path):
    file = tmp_path / "noise.toml"
    file.write_text('preset = "worn"\n[assumed]\nwheel_scale_error = 0.02\n')
    config = tours.tour("apartment", "ekf", "worn", 10.0, file, features={"landmarks": "both"})
    assert config.preset == "worn"
    assert config.world.wheel_scale_error == 0.02
    assert config.assumed.wheel_scale_error == 0.02
    assert config.features.landmarks == "both"


def test_tours_with_walls_have_their_figures_and_a_row(tours, monkeypatch):
    script = importlib.import_module("wall_tours")
    config = tours.tour("block", "ekf", "default", 4.0, features={"landmarks": "both"})
    figures = script.tour_figures([tours.make_row(config)])
    assert figures["runs"] == figures["tour_ended"] == 1
    assert len(script.line(("block", "default", "both", "ekf"), figures)) == 9
    assert script.line(("block", "default", "corners", "ekf"), figures)[3] == ""
