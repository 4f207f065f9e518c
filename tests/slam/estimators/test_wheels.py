"""The wheels' parameters on line: the laws, for all shipped estimators, and NEES of pose and parameters."""

import numpy as np
import pytest
from laws.wheels import LAWS, PRIOR, calibrated, estimate_of

import sixthsense as ss
from sixthsense.config import ConfigError, preset
from sixthsense.core.geometry import wrap_angle
from sixthsense.core.wheels import PARAMETERS, Wheels
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS, estimates_wheels
from sixthsense.testing.estimation import make

CALIBRATING = [name for name in ESTIMATORS if estimates_wheels(make(name))]


def test_the_invariant_filter_and_the_smoother_estimate_wheels():
    assert CALIBRATING == ["ekf-invariant", "isam2"]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", CALIBRATING)
def test_estimated_wheels_keep_the_laws(name, law):
    law.check(name)


@pytest.mark.parametrize("name", CALIBRATING)
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


def test_the_option_is_refused_where_the_wheels_cannot_be_estimated():
    with pytest.raises(ConfigError, match="calibrate_wheels: found true with ekf, allowed: with ekf-invariant"):
        preset("default", calibrate_wheels=True, estimator="ekf")
