"""The wheels' parameters on line: the laws, for all shipped estimators, and NEES of pose and parameters."""

import numpy as np
import pytest
from laws.wheels import LAWS, PRIOR, calibrated, estimate_of

import sixthsense as ss
from sixthsense.config import ConfigError, preset
from sixthsense.core.geometry import wrap_angle
from sixthsense.core.wheels import PARAMETERS, Wheels
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.slam.estimators.ekf import EKF


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_estimated_wheels_keep_the_laws(name, law):
    law.check(name)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_with_wheels_from_the_prior_pose_and_parameters_are_consistent(name):
    """Each run with other wheels."""
    runs, of_pose, of_wheels = 8 if name == "isam2" else 40, [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        wheels = Wheels.from_array(np.linalg.cholesky(PRIOR.cov) @ rng.standard_normal(PARAMETERS))
        estimator, true = calibrated(name, 40, 0.01, rng, wheels)
        estimate, found = estimator.estimate(), estimate_of(estimator)
        error = estimate.pose.array() - true.array()
        error[2] = wrap_angle(error[2])
        off = found.values.array() - wheels.array()
        of_pose.append(error @ np.linalg.solve(estimate.pose_cov, error))
        of_wheels.append(off @ np.linalg.solve(found.cov, off))
    for values, freedom in ((of_pose, 3), (of_wheels, PARAMETERS)):
        low, high = nees_band(runs, freedom, confidence=0.99)
        assert low < np.mean(values) < high


def test_a_run_with_worn_wheels_finds_their_errors_and_its_folder_keeps_them(tmp_path):
    fields = {"scene": "rectangle", "task": "tour", "max_time": 25.0, "estimator": "ekf-invariant"}
    config = preset("worn", **fields, calibrate_wheels=True)
    run = ss.run(config, out=tmp_path / "run")
    for key, true in (("forward_scale", 0.02), ("turn_scale", 0.02)):
        found, sigma = run.metrics[f"wheel_{key}_error"], run.metrics[f"wheel_{key}_sigma"]
        assert abs(found - true) < 3.5 * sigma and sigma < 0.03
    assert np.array_equal(ss.load(tmp_path / "run").trace.wheels, run.trace.wheels)


class Points:
    """An estimator of a user's, with the six methods that association and update need."""

    def __init__(self, start, start_cov):
        self._own = EKF(start, start_cov)

    def __getattr__(self, name):
        if name in ("predict", "update", "forget", "estimate", "joint_covariance", "trajectory"):
            return getattr(self._own, name)
        raise AttributeError(name)


def test_an_estimator_without_wheels_is_told_where_they_are_asked_for():
    with pytest.raises(ConfigError, match=r"calibrate_wheels: found true with .*Points, allowed: a shipped estimator"):
        ss.run("rectangle", estimator=Points, calibrate_wheels=True, task="tour", max_time=1.0)
