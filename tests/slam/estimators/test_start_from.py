"""Beginning with the landmarks of an earlier run: NEES over runs in a row."""

import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised
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
