"""Position and heading of the whole map are unobservable: which filters gain information about them."""

import numpy as np
import pytest

from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.estimation import CONSISTENT
from sixthsense.testing.observability import heading_variances, nullity, observability_gramian

FILTERS = [name for name in ESTIMATORS if name != "isam2"]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("name", "expected"), [(n, 2 if n == "ekf" else 3) for n in FILTERS])
def test_the_standard_filter_observes_the_heading_of_the_world_and_the_others_do_not(name, expected, seed):
    assert nullity(observability_gramian(name, seed, noise=True)) == expected


@pytest.mark.parametrize("name", FILTERS)
def test_linearized_at_the_truth_no_filter_observes_pose_and_heading_of_the_world(name):
    assert nullity(observability_gramian(name, 0, noise=False)) == 3


@pytest.mark.parametrize("seed", range(5))
def test_the_standard_filter_does_not_observe_the_position_of_the_world(seed):
    gramian = observability_gramian("ekf", seed, noise=True)
    shifts = np.tile(np.eye(2), (5, 1))
    null = np.vstack([np.eye(2), np.zeros((1, 2)), shifts])
    assert np.abs(gramian @ null).max() < 1e-9 * np.abs(gramian).max()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CONSISTENT)
def test_the_heading_variance_never_falls_below_that_of_the_start(name, seed):
    """No measurement depends on the world's axes."""
    assert heading_variances(name, seed).min() > 1.0


@pytest.mark.parametrize("seed", range(3))
def test_the_standard_filters_heading_variance_falls_below_that_of_the_start(seed):
    """The known inconsistency: the variance falls to 0.22 to 0.32 of a value that no measurement can lower."""
    assert heading_variances("ekf", seed).min() < 0.5
