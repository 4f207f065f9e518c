"""Runs in groups: their names and limits, and their curves at common places."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.evaluation.curves import Curves
from sixthsense.evaluation.groups import Sample, differences, grouped, resampled, usual_grouping


def curve(values, step_s=1.0):
    """Position errors at keyframes, half a metre a second."""
    time_s = step_s * np.arange(len(values))
    return Curves(time_s, 0.5 * time_s, np.array(values), 0.1 * np.array(values), np.full(len(values), 3.0))


def sample(metrics=None, **fields):
    return Sample("study", ss.preset(**{"scene": "block"} | fields), lambda: metrics or {}, lambda: None)


def test_runs_are_resampled_with_the_value_of_their_latest_keyframe():
    places, values = resampled([curve([1.5, 2.5, 3.5, 4.5], 199.0 / 3)], "position_m", "time")
    assert places == pytest.approx(np.arange(200.0))
    expected = [1.5, 1.5, 2.5, 2.5, 3.5, 3.5, 4.5]
    assert values[0, [0, 66, 67, 132, 133, 198, 199]].tolist() == expected
    places, values = resampled([curve([1.5, 2.5], 199.0)], "heading_rad", "distance")
    assert places == pytest.approx(0.5 * np.arange(200.0)) and values[0, [198, 199]] == pytest.approx([0.15, 0.25])


def test_curves_go_as_far_as_more_than_half_of_the_runs():
    runs = [curve(np.full(length, float(length))) for length in (41, 11, 31, 21)]
    places, values = resampled(runs, "position_m", "time")
    assert places[-1] == 20.0
    assert np.isnan(values[1, places > 10.0]).all() and np.isfinite(values[[0, 2, 3]]).all()
    assert resampled(runs[:3], "position_m", "time")[0][-1] == 30.0


def test_groups_are_by_any_field_or_several_and_at_most_twelve():
    samples = [sample(estimator=name, seed=seed) for name in ("ekf", "isam2") for seed in range(6)]
    assert [(group.name, len(group.samples)) for group in grouped(samples, "estimator")] == [("ekf", 6), ("isam2", 6)]
    assert [group.name for group in grouped(samples, ("scene", "estimator"))] == ["block · ekf", "block · isam2"]
    other = sample(laser={"beams": 90})
    assert [group.name for group in grouped([*samples, other], "laser.beams")] == ["laser.beams 360", "laser.beams 90"]
    assert len(grouped(samples, ("estimator", "seed"))) == 12
    with pytest.raises(InputError, match="by: found 13 groups by estimator, seed, allowed: at most 12"):
        grouped([*samples, sample(seed=9)], ("estimator", "seed"))
    with pytest.raises(InputError, match=r"by: found 'laser.beam'.*laser.beams"):
        grouped(samples, "laser.beam")
    assert usual_grouping([one.fields for one in samples]) == ["estimator"]
    apart = samples[0], sample(scene="office", estimator="ekf", seed=3)
    assert usual_grouping([one.fields for one in apart]) == ["scene"]


def test_a_metric_of_a_group_is_of_the_runs_that_have_it_and_finite():
    rows = [{"plans": 3}, {"plans": 4.5}, {"plans": float("nan")}, {"plans": "none"}, {}]
    (group,) = grouped([sample(row, seed=k) for k, row in enumerate(rows)], "scene")
    assert group.metric("plans").tolist() == [3.0, 4.5]


def test_a_title_has_what_differs_with_the_number_of_its_values_and_what_is_the_same():
    rows = [sample(seed=k, estimator=name).fields for k, name in ((2, "ekf"), (3, "isam2"), (4, "isam2"))]
    told = "same: block, landmarks, default, astar, explore"
    assert differences(rows) == f"differs: estimator (2), seed (3) — {told}"
    assert differences(rows[:1]) == "same: block, ekf, landmarks, default, astar, explore, seed 2"
