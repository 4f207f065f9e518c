"""NEES and NIS of all estimators on odometry and observations with exactly the assumed noise."""

import math

import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised, slow_but
from point_world import POINTS, joint_state, make, noisy, sight, step
from predicted import predict_points
from scipy.stats import chi2

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Pose
from sixthsense.slam.estimators import ESTIMATORS


def short_drive(name, seed, steps=50, sigma=0.03):
    """NEES of pose (3) and whole state (13) at the end; NIS and its degrees of freedom along the way."""
    rng = np.random.default_rng(seed)
    estimator, true, nis, dof = make(name, Pose(), np.zeros((3, 3)), ISAM2Config()), Pose(), 0.0, 0
    for k in range(steps):
        odometry = step(0.15, 0.05 * math.sin(0.2 * k), 0.01)
        true = true @ noisy(odometry, rng)
        estimator.predict(odometry)
        seen = sight(true, range(5), rng, sigma)
        if k % 5 == 4:
            estimate = estimator.estimate()
            z, by_pose, by_landmark = predict_points(estimate.pose, estimate.landmarks)
            H = np.hstack([by_pose.reshape(-1, 3), np.kron(np.eye(5), by_landmark)])
            S = H @ estimator.joint_covariance(estimate.ids.tolist()) @ H.T + np.eye(10) * sigma**2
            nis += normalised(np.concatenate([seen[i].z for i in estimate.ids.tolist()]) - z.ravel(), S)
            dof += 10
        estimator.update(seen)
    estimate, joint = joint_state(estimator)
    error = error_of(estimate, true, POINTS)
    return normalised(error[:3], joint[:3, :3]), normalised(error, joint), nis, dof


@pytest.mark.parametrize("name", slow_but("isam2", ESTIMATORS))
def test_on_short_drives_pose_map_and_innovations_are_consistent(name):
    """40 runs; with little rotation the standard filter is consistent, too."""
    runs = 40
    pose, whole, nis, dof = np.array([short_drive(name, seed) for seed in range(runs)]).T
    assert_consistent(pose, 3)
    assert_consistent(whole, 13)
    low, high = chi2.ppf([0.005, 0.995], dof.sum())  # innovations are white, so those of one run are independent
    assert low < nis.sum() < high
