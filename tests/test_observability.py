"""What each filter believes to have learnt: odometry and sightings say nothing of where the map lies, nor how it turns.

The system has three unobservable directions, the world's motions. All is read from outside, from covariances before
and after each step: Phi from the covariance of pose and landmarks, H^T R^-1 H as the information an update adds.
"""

import numpy as np
import pytest
from estimation import (
    CONSISTENT,
    START,
    START_COV,
    everything,
    make,
    noisy,
    sight,
    sight_exactly,
    step,
)

from sixthsense.config import ISAM2Config
from sixthsense.estimators import ESTIMATORS
from sixthsense.landmarks import turned

FILTERS = [name for name in ESTIMATORS if name != "isam2"]


def coordinates(name, estimate):
    """A (n, n): world errors = A times the errors in which the filter is linear.

    Those of the consistent ones are xi: the invariant's by design, the others' because what is kept about their points
    of linearisation is handed out about the estimates.
    """
    size = 3 + 2 * len(estimate.ids)
    A = np.eye(size)
    if name != "ekf":
        rest = [i for i in range(size) if i != 2]
        A[rest, 2] = turned(np.vstack([estimate.pose.position, estimate.landmarks])).ravel()
    return A


def own_covariance(name, estimator):
    estimate, joint = everything(estimator)
    back = np.linalg.inv(coordinates(name, estimate))
    return back @ joint @ back.T


def observability_gramian(name, seed, noise):
    """Sum over a window of Phi(k, 0)^T H_k^T R_k^-1 H_k Phi(k, 0), in the filter's own coordinates."""
    rng = np.random.default_rng(seed)
    estimator, true = make(name), START
    estimator.update(sight(true, range(5), rng) if noise else sight_exactly(name, true, range(5)))
    updated = own_covariance(name, estimator)
    transition, gramian = np.eye(len(updated)), np.zeros_like(updated)
    for _ in range(12):
        odometry = step(sigma=0.05)
        true = true @ (noisy(odometry, rng) if noise else odometry.motion)
        estimator.predict(odometry)
        predicted = own_covariance(name, estimator)
        phi = np.eye(len(updated))  # so it is for xi, whose landmarks only the odometry's noise reaches
        if name == "ekf":  # Sigma_lp' = Sigma_lp Phi^T
            phi[:3, :3] = np.linalg.lstsq(updated[3:, :3], predicted[3:, :3])[0].T
        estimator.update(sight(true, range(5), rng) if noise else sight_exactly(name, true, range(5)))
        updated = own_covariance(name, estimator)
        transition = phi @ transition
        gramian += transition.T @ (np.linalg.inv(updated) - np.linalg.inv(predicted)) @ transition
    return gramian


def nullity(gramian):
    """How many directions are not observed; rounding leaves them 1e-15 of the largest, noise makes it 1e-5."""
    eigenvalues = np.linalg.eigvalsh(gramian)
    return int(np.sum(np.abs(eigenvalues) < 1e-9 * eigenvalues[-1]))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("name", "expected"), [(n, 2 if n == "ekf" else 3) for n in FILTERS])
def test_the_standard_filter_observes_the_heading_of_the_world_and_the_others_do_not(name, expected, seed):
    assert nullity(observability_gramian(name, seed, noise=True)) == expected


@pytest.mark.parametrize("name", FILTERS)
def test_linearised_at_the_truth_no_filter_observes_how_the_world_lies(name):
    assert nullity(observability_gramian(name, 0, noise=False)) == 3


@pytest.mark.parametrize("seed", range(5))
def test_what_the_standard_filter_still_cannot_observe_is_where_the_world_lies(seed):
    gramian = observability_gramian("ekf", seed, noise=True)
    shifts = np.tile(np.eye(2), (5, 1))
    null = np.vstack([np.eye(2), np.zeros((1, 2)), shifts])
    assert np.abs(gramian @ null).max() < 1e-9 * np.abs(gramian).max()


def least_heading_variance(name, seed):
    """The least heading variance on a drive of several loops, by that of the start."""
    rng = np.random.default_rng(seed)
    estimator, true, least = make(name, isam2=ISAM2Config()), START, np.inf
    for _ in range(150):
        odometry = step(sigma=0.04)
        true = true @ noisy(odometry, rng)
        estimator.predict(odometry)
        estimator.update(sight(true, rng.choice(5, 3, replace=False), rng, 0.1))
        least = min(least, estimator.estimate().pose_cov[2, 2])
    return least / START_COV[2, 2]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CONSISTENT)
def test_the_heading_never_gets_better_known_than_it_was_at_the_start(name, seed):
    """Nothing that was measured knows about the world's axes."""
    assert least_heading_variance(name, seed) > 1.0


@pytest.mark.parametrize("seed", range(3))
def test_the_standard_filter_comes_to_know_the_heading_better_than_at_the_start(seed):
    """Which is its error, shown as it is: at the least 0.22 to 0.32 of the variance that no measurement can lower."""
    assert least_heading_variance("ekf", seed) < 0.5
