"""Runs in groups: their names and limits, and their curves at common places."""

import numpy as np
import pandas as pd
import pytest

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.evaluation.groups import Sample, grouped, numbers, resampled, table_of, usual_grouping


def curve(values, step_s=1.0):
    """Position errors at keyframes, half a metre a second."""
    time_s = step_s * np.arange(len(values))
    values = np.array(values)
    return pd.DataFrame(
        {"time_s": time_s, "distance_m": 0.5 * time_s, "position_m": values, "heading_rad": 0.1 * values, "nees": 3.0}
    )


def sample(metrics=None, **fields):
    return Sample("study", ss.preset(**{"scene": "block"} | fields), lambda: metrics or {}, lambda: None)


def test_runs_are_resampled_with_the_value_of_their_latest_keyframe():
    values = resampled([curve([1.5, 2.5, 3.5, 4.5], 199.0 / 3)], "position_m", "time_s")
    assert values.index.to_numpy() == pytest.approx(np.arange(200.0))
    expected = [1.5, 1.5, 2.5, 2.5, 3.5, 3.5, 4.5]
    assert values[0].iloc[[0, 66, 67, 132, 133, 198, 199]].tolist() == expected
    values = resampled([curve([1.5, 2.5], 199.0)], "heading_rad", "distance_m")
    assert values.index.to_numpy() == pytest.approx(0.5 * np.arange(200.0))
    assert values[0].iloc[[198, 199]].to_numpy() == pytest.approx([0.15, 0.25])
    standing = curve([1.5, 2.5, 3.5])
    standing["distance_m"], standing["nees"] = [0.0, 7.0, 7.0], [np.nan, 2.0, np.nan]
    assert resampled([standing], "position_m", "distance_m")[0].iloc[-1] == 3.5
    assert resampled([standing], "nees", "time_s").index[0] == pytest.approx(1.0, abs=0.01)  # none before the first


def test_curves_go_as_far_as_more_than_half_of_the_runs():
    runs = [curve(np.full(length, float(length))) for length in (41, 11, 31, 21)]
    values = resampled(runs, "position_m", "time_s")
    assert values.index[-1] == 20.0
    assert values.loc[values.index > 10.0, 1].isna().all() and values[[0, 2, 3]].notna().all(axis=None)
    assert resampled(runs[:3], "position_m", "time_s").index[-1] == 30.0


def test_groups_are_by_any_field_or_several_and_at_most_twelve():
    samples = [sample(estimator=name, seed=seed) for name in ("ekf", "isam2") for seed in range(6)]
    assert {name: len(found) for name, found in grouped(samples, "estimator").items()} == {"ekf": 6, "isam2": 6}
    assert list(grouped(samples, ("scene", "estimator"))) == ["block · ekf", "block · isam2"]
    other = sample(laser={"beams": 90})
    assert list(grouped([*samples, other], "laser.beams")) == ["laser.beams 360", "laser.beams 90"]
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
    samples = [sample(row, seed=k) for k, row in enumerate(rows)]
    assert numbers(samples, "plans").tolist() == [3.0, 4.5]
    frame = table_of([*samples, sample({"ate_rmse_m": 0.25})])
    assert frame.attrs["units"] == {"plans": "", "ate_rmse_m": "m"} and frame["seed"].tolist() == [0, 1, 2, 3, 4, 0]
