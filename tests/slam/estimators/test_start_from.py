"""Beginning with the landmarks of an earlier run: the laws, for all shipped estimators, and NEES over runs in a row."""

import numpy as np
import pytest
from laws.prior_map import LAWS, begun, prior_from
from laws.wheels import PRIOR, TRUE, calibrated, increment

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.batch import to_robot
from sixthsense.testing.estimation import POINTS, make, noisy, sight, step

WALLS = np.array([[0.0, 5.0], [0.5 * np.pi, 4.0]])
LANDMARKS = np.vstack([POINTS, WALLS])
START_COV = np.diag([0.05, 0.05, 0.02]) ** 2


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_estimators_that_begin_with_a_prior_map_keep_the_laws(name, law):
    law.check(name)


def drive(estimator, true, rng, sigma):
    """Twenty steps among all landmarks, three of them in sight at a time; the true pose at the end."""
    for _ in range(20):
        motion = step(0.3, 0.3, sigma)
        true = true @ noisy(motion, rng)
        estimator.predict(motion)
        seen = {}
        for i in rng.choice(len(LANDMARKS), 3, replace=False).tolist():
            wall = i >= len(POINTS)
            z = to_robot(true.array(), LANDMARKS[i], wall) + sigma * rng.standard_normal(2)
            seen[i] = Observation(Kind.WALL if wall else Kind.CORNER, z, sigma**2 * np.eye(2), (-1.0, 1.0))
        estimator.update(seen)
    return true


def runs_in_a_row(name, seed, sigma, start_cov, runs=4):
    """Errors and covariances of pose and landmarks after each of some runs, each beginning with the last one's map."""
    rng, start, prior, found = np.random.default_rng(seed), Pose(0.5, 0.5, 0.2), None, []
    for _ in range(runs):
        true = Pose.from_array(start.array() + np.sqrt(np.diag(start_cov)) * rng.standard_normal(3))
        estimator = make(name, start, start_cov) if prior is None else begun(name, prior, start, start_cov)
        true = drive(estimator, true, rng, sigma)
        prior = prior_from(estimator)
        estimate = estimator.estimate()
        error = np.append(estimate.pose.array() - true.array(), estimate.landmarks - LANDMARKS[estimate.ids])
        angles = np.append([2], 3 + 2 * np.flatnonzero(estimate.walls))
        error[angles] = wrap_angle(error[angles])
        found.append((error, estimator.joint_covariance(estimate.ids.tolist())))
    return found


@pytest.mark.parametrize("name", ["ekf-invariant", "isam2"])
def test_pose_and_map_are_consistent_after_each_of_four_runs_in_a_row(name):
    nees, seeds = np.zeros((4, 2)), 12 if name == "isam2" else 25
    for seed in range(seeds):
        for k, (error, cov) in enumerate(runs_in_a_row(name, seed, 0.02, START_COV)):
            nees[k, 0] += error[:3] @ np.linalg.solve(cov[:3, :3], error[:3])
            nees[k, 1] += error[3:] @ np.linalg.solve(cov[3:, 3:], error[3:])
    low, high = nees_band(seeds, confidence=0.999)
    assert (nees[:, 0] / seeds > low).all() and (nees[:, 0] / seeds < high).all()
    low, high = nees_band(seeds, 2 * len(LANDMARKS), confidence=0.999)
    assert (nees[:, 1] / seeds > low).all() and (nees[:, 1] / seeds < high).all()


@pytest.mark.parametrize("name", ["ekf-invariant", "isam2"])
def test_each_run_makes_the_map_better_and_says_so(name):
    errors, sigmas = np.zeros(4), np.zeros(4)
    for seed in range(10):
        for k, (error, cov) in enumerate(runs_in_a_row(name, seed, 0.02, START_COV)):
            errors[k] += np.sum(error[3:] ** 2)
            sigmas[k] += np.trace(cov[3:, 3:])
    assert (np.diff(sigmas) < 0.0).all()
    assert errors[3] < 0.6 * errors[0] and sigmas[3] < 0.6 * sigmas[0]


@pytest.mark.parametrize("name", ["ekf-invariant", "isam2"])
def test_wheels_are_estimated_beside_a_prior_map(name):
    """Landmarks of an earlier run say as much of the wheels as the same landmarks say in one run."""
    rng, sigma = np.random.default_rng(3), 0.01
    first, _ = calibrated(name, 40, sigma, rng)
    start, cov = Pose(), 1e-6 * np.eye(3)
    estimator = make(name, start, cov)
    estimator.estimate_wheels(PRIOR)
    prior = prior_from(first)
    estimator.start_from(prior)
    with pytest.raises(RuntimeError, match="estimate_wheels"):
        estimator.estimate_wheels(PRIOR)
    at = start
    for k in range(40):
        motion = np.diag([sigma, sigma, 0.5 * sigma]) ** 2
        at = at @ noisy(increment(k, TRUE, motion), rng)
        estimator.predict(increment(k, estimator.wheels().values, motion))
        estimator.update(sight(at, rng.choice(len(POINTS), 3, replace=False).tolist(), rng, 5.0 * sigma))
    found = estimator.wheels()
    off = found.values.array() - TRUE.array()
    assert off @ np.linalg.solve(found.cov, off) < 18.5  # 0.999 of chi-square with 4 degrees of freedom
    assert np.trace(found.cov) < 0.5 * np.trace(PRIOR.cov)
