"""Runs of the whole pipeline that begin at a pose that is only roughly known.

The error of the start stays in all poses, since nothing that the robot sees refers to the world. So the mean NEES over
the keyframes of a run has at most the variance of a single NEES, and the chi-square band of as many runs holds for it.
"""

import functools

import numpy as np
import pytest
from laws.nees import slow_but
from laws.short_tours import driven, replayed, short_tour

from sixthsense.core.geometry import Pose
from sixthsense.evaluation.metrics import nees_band, nees_world

START_COV = np.array([[0.01, 0.004, 0.001], [0.004, 0.02, -0.001], [0.001, -0.001, 0.0016]])
TOURS, STARTS = range(1000, 1006), 3
SECONDS = 6.0


@functools.cache
def recorded(seed):
    config = short_tour("ekf", seed, SECONDS)
    return config, driven(config)[0]


def run_nees(estimator, assumed_cov):
    """NEES of the pose at the first keyframe, and its mean over all keyframes, (runs, 2)."""
    rows = []
    for seed in TOURS:
        config, ticks = recorded(seed)
        for k in range(STARTS):
            error = np.random.default_rng([seed, k]).multivariate_normal(np.zeros(3), START_COV)
            start = Pose.from_array(ticks[0].truth.array() + error)
            own = config.replaced(estimator=estimator)
            run = replayed(ticks, own, start=start, start_cov=assumed_cov)
            nees = nees_world(run.poses - run.truths, run.covs)
            rows.append([nees[0], nees.mean()])
    return np.array(rows)


@pytest.mark.parametrize("estimator", slow_but("ekf-invariant", ["ekf-invariant", "isam2"]))
def test_runs_from_starts_drawn_from_their_covariance_are_consistent_from_the_first_keyframe_on(estimator):
    rows = run_nees(estimator, START_COV)
    low, high = nees_band(len(rows), confidence=0.999)
    first, mean = rows.mean(axis=0)
    assert low < first < high
    assert low < mean < high


def test_starts_with_a_covariance_stated_at_a_third_leave_the_band():
    rows = run_nees("ekf-invariant", START_COV / 3.0)
    _, high = nees_band(len(rows), confidence=0.999)
    assert (rows.mean(axis=0) > high).all()
