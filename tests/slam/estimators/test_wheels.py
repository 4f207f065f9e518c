"""The wheels' parameters on line: the laws, for all shipped estimators, and NEES of pose and parameters."""

import numpy as np
import pytest

from sixthsense.core.geometry import wrap_angle
from sixthsense.core.wheels import Wheels
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS, estimates_wheels
from sixthsense.testing.check import WHEEL_LAWS
from sixthsense.testing.estimation import make
from sixthsense.testing.wheels import PRIOR, calibrated, estimate_of

CALIBRATING = [name for name in ESTIMATORS if estimates_wheels(make(name))]


def test_the_invariant_filter_and_the_smoother_estimate_wheels():
    assert CALIBRATING == ["ekf-invariant", "isam2"]


@pytest.mark.parametrize("law", WHEEL_LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", CALIBRATING)
def test_estimated_wheels_keep_the_laws(name, law):
    law.check(name)


@pytest.mark.parametrize("name", CALIBRATING)
def test_with_wheels_from_the_prior_pose_and_parameters_are_consistent(name):
    """40 runs, each with other wheels."""
    runs, of_pose, of_wheels = 40, [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        wheels = Wheels.from_array(np.linalg.cholesky(PRIOR.cov) @ rng.standard_normal(4))
        estimator, true = calibrated(name, 40, 0.01, rng, wheels)
        estimate, found = estimator.estimate(), estimate_of(estimator)
        error = estimate.pose.array() - true.array()
        error[2] = wrap_angle(error[2])
        off = found.values.array() - wheels.array()
        of_pose.append(error @ np.linalg.solve(estimate.pose_cov, error))
        of_wheels.append(off @ np.linalg.solve(found.cov, off))
    for values, freedom in ((of_pose, 3), (of_wheels, 4)):
        low, high = nees_band(runs, freedom, confidence=0.99)
        assert low < np.mean(values) < high
