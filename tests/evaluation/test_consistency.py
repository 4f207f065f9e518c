"""The whole pipeline, real features and unknown association included, is as sure as it should be."""

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.evaluation.measure import measure
from sixthsense.loop import run


def test_the_prediction_is_less_certain_than_the_update_and_both_have_their_nees():
    """The predicted pose is that of the estimator between `predict` and `update`: the motion since the last update."""
    trace = run(preset(scene="rectangle", task="tour", max_time=20.0, estimator="ekf-invariant"))
    for k, predicted in enumerate(trace.key_predicted[1:], start=1):
        expected = trace.key_estimates[k - 1].pose @ trace.key_odometry[k].motion
        assert np.allclose(predicted.pose.array(), expected.array(), atol=1e-12)
        updated = trace.key_estimates[k].pose_cov
        assert np.linalg.eigvalsh(predicted.pose_cov - updated)[0] > -1e-12
    values = measure(trace)
    assert 0.0 < values["prediction_nees_world_mean"] < 10.0
    assert 0.0 <= values["pose_nees_in_band"] <= 1.0
    assert values["discarded_share"] < 0.05


@pytest.mark.slow
def test_a_long_tour_with_worn_wheels_stays_near_the_truth():
    """30 tours of 300 s; the wheels' systematic errors, which no estimator knows, cost some consistency."""
    values = [run(preset("worn", task="tour", max_time=300.0, seed=seed)) for seed in range(30)]
    metrics = [measure(t) for t in values]
    assert all(m["outcome"] == "tour ended" for m in metrics)
    assert max(m["ate_rmse_m"] for m in metrics) < 0.03
    assert max(m["ate_rmse_m"] / m["dead_reckoning_ate_rmse_m"] for m in metrics) < 1 / 3
    assert np.mean([m["pose_nees_world_mean"] for m in metrics]) < 6.0
