"""Figures of groups of runs: medians and bands over the runs of a group, averaged NEES, relative errors."""

import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

import sixthsense as ss
from sixthsense.core.geometry import Array
from sixthsense.evaluation.curves import Curves, curves
from sixthsense.evaluation.groups import Group, Sample, grouped, resampled
from sixthsense.evaluation.measure import measure
from sixthsense.figures import groups
from sixthsense.figures.panels import KINDS


def curve(values: Array, step_s: float = 1.0, nees: Array | None = None) -> Curves:
    """Position errors at keyframes, half a metre a second."""
    time_s = step_s * np.arange(len(values), dtype=np.float64)
    return Curves(time_s, 0.5 * time_s, values, 0.1 * values, np.full(len(values), 3.0) if nees is None else nees)


def sample(errors: Array, **fields) -> Sample:
    metrics = {"outcome": "tour ended", "ate_rmse_m": float(errors.mean())}
    metrics |= {f"rpe_{part}_{m}m": float(errors[0]) * m for part in ("trans_m", "rot_deg") for m in (1, 2, 5, 10)}
    return Sample("study", ss.preset(scene="block", **fields), lambda: metrics, lambda: curve(errors))


@pytest.fixture
def samples() -> list[Sample]:
    """Two estimators over five seeds each, whose errors are constant: 1 to 5, and 11 to 15."""
    return [
        sample(np.full(40, 1.0 + seed + 10.0 * k), estimator=name, seed=seed)
        for k, name in enumerate(("ekf", "isam2"))
        for seed in range(5)
    ]


@pytest.fixture
def ax():
    return Figure().add_subplot()


def test_runs_are_resampled_with_the_value_of_their_latest_keyframe() -> None:
    places, values = resampled([curve(np.array([1.0, 2.0, 3.0]))], "position_m", "time")
    assert (places[0], places[-1]) == (0.0, 2.0)
    assert values[0, places < 1.0].max() == 1.0 and values[0, (places >= 1.0) & (places < 2.0)].max() == 2.0
    places, _ = resampled([curve(np.ones(3))], "position_m", "distance")
    assert places[-1] == 1.0


def test_curves_go_as_far_as_more_than_half_of_the_runs() -> None:
    runs = [curve(np.full(length, float(length))) for length in (11, 21, 31, 41)]
    places, values = resampled(runs, "position_m", "time")
    assert places[-1] == 20.0
    assert np.isnan(values[0, places > 10.0]).all() and np.isfinite(values[1:]).all()


def test_the_median_and_the_band_are_those_of_the_runs_of_a_group(ax, samples) -> None:
    for k, group in enumerate(grouped(samples, "estimator")):
        groups.draw_spread(ax, group, "position_m", "time", k)
    assert [line.get_label() for line in ax.get_lines()] == ["ekf, 5 runs", "isam2, 5 runs"]
    assert [set(line.get_ydata()) for line in ax.get_lines()] == [{3.0}, {13.0}]
    bands = [band.get_paths()[0].vertices[:, 1] for band in ax.collections]
    assert [(band.min(), band.max()) for band in bands] == [pytest.approx((1.4, 4.6)), pytest.approx((11.4, 14.6))]
    assert len({line.get_color() for line in ax.get_lines()}) == 2


def test_the_averaged_nees_of_consistent_runs_lies_in_its_band_95_times_of_100(ax) -> None:
    rng = np.random.default_rng(0)
    draws = [curve(np.zeros(3000), nees=rng.chisquare(3, 3000)) for _ in range(10)]
    runs = tuple(Sample("", ss.preset(seed=k), dict, lambda one=one: one) for k, one in enumerate(draws))
    groups.draw_mean_nees(ax, [Group("ekf", runs)], "time")
    edges = ax.collections[0].get_paths()[0].vertices[:, 1]
    low, high = edges.min(), edges.max()
    mean = np.asarray(ax.get_lines()[0].get_ydata())
    assert (low, high) == pytest.approx((1.68, 4.70), abs=0.01)  # chi-square of 30 degrees of freedom, over 10
    assert 0.9 < np.mean((mean >= low) & (mean <= high)) < 0.99
    assert ax.get_legend_handles_labels()[1][:1] == ["95 % band of the mean of 10 runs"]


def test_groups_are_by_any_field_or_several(samples) -> None:
    assert [group.name for group in grouped(samples, "estimator")] == ["ekf", "isam2"]
    assert [group.name for group in grouped(samples, ("scene", "estimator"))] == ["block · ekf", "block · isam2"]
    other = sample(np.ones(3), laser={"beams": 90})
    assert [group.name for group in grouped([*samples, other], "laser.beams")] == ["laser.beams 360", "laser.beams 90"]


def test_the_curves_of_a_run_are_its_errors(explored) -> None:
    trace = explored.trace
    found = curves(trace)
    assert found is not None
    assert np.nanmean(found.nees) == pytest.approx(measure(trace)["pose_nees_world_mean"])
    truth, estimates = np.array(trace.key_truths), np.array([one.pose.array() for one in trace.key_estimates])
    np.testing.assert_allclose(found.position_m, np.linalg.norm((estimates - truth)[:, :2], axis=1))
    assert found.distance_m[0] == 0.0 and (np.diff(found.distance_m) >= 0.0).all()
    assert 0.3 < found.distance_m[-1] <= trace.path_length_m
    assert found.time_s[-1] == pytest.approx(1e-9 * (trace.key_stamps_ns[-1] - trace.stamps_ns[0]))
    assert curves(dataclasses.replace(trace, key_truths=[])) is None


@pytest.mark.parametrize("what", sorted({*KINDS} - {"rpe"}))
def test_every_figure_is_drawn_on_axes_of_ones_own(explored, what) -> None:
    panels = {"error": 3, "nees": 2}.get(what, 1)
    own = Figure().subplots(panels, 1, squeeze=False).ravel()
    assert explored.plot(what, ax=own) is None
    assert all(ax.has_data() for ax in own) and "rectangle" in own[0].get_title()
    one = Figure().add_subplot()
    one.set_title("my own")
    explored.plot(what, ax=one)
    assert one.has_data() and one.get_title() == "my own"
