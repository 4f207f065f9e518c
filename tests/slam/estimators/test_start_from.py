"""Beginning with the landmarks of an earlier run: NEES over runs in a row."""

import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised
from laws.parameters import PRIOR, TRUE, WHEELS
from laws.prior_map import begun, prior_from
from point_world import POINTS, make, noisy, step

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.testing.batch import to_robot

WALLS = np.array([[0.0, 5.0], [0.5 * np.pi, 4.0]])
LANDMARKS = np.vstack([POINTS, WALLS])
START_COV = np.diag([0.05, 0.05, 0.02]) ** 2


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
        found.append((error_of(estimate, true, LANDMARKS), estimator.joint_covariance(estimate.ids.tolist())))
    return found


@pytest.mark.parametrize("name", ["ekf-invariant", "isam2"])
def test_pose_and_map_are_consistent_after_each_of_four_runs_in_a_row(name):
    runs = [runs_in_a_row(name, seed, 0.02, START_COV) for seed in range(12 if name == "isam2" else 25)]
    for k in range(4):
        for part, dof in ((slice(0, 3), 3), (slice(3, None), 2 * len(LANDMARKS))):
            nees = [normalised(run[k][0][part], run[k][1][part, part]) for run in runs]
            assert_consistent(nees, dof, confidence=0.999)


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
    first, _ = WHEELS.driven(name, 40, sigma, rng)
    estimator = WHEELS.start(name, None, Pose(), 1e-6 * np.eye(3))
    estimator.start_from(prior_from(first))
    with pytest.raises(RuntimeError, match="calibrate wheels"):
        estimator.calibrate(PRIOR)
    WHEELS.drive(estimator, 40, sigma, rng, TRUE)
    found = estimator.calibration(type(TRUE))
    assert (
        normalised(found.values.array() - TRUE.array(), found.cov) < 18.5
    )  # 0.999 of chi-square, 4 degrees of freedom
    assert np.trace(found.cov) < 0.5 * np.trace(PRIOR.cov)
