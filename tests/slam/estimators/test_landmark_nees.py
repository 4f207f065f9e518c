"""NEES of landmarks: 2 if consistent, where the true wall or point is known."""

import numpy as np
import pytest
from point_world import joint_state, make

from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.metrics import nees_band, nees_landmarks
from sixthsense.testing.estimators import BOTH, MOTION, START, START_COV

RUNS = 150


def landmark_nees(name, seed, steps=6):
    """(n,) NEES of all points and walls after a drive with known association, and which are walls."""
    rng = np.random.default_rng(seed)
    true = Pose.from_array(START.array() + np.linalg.cholesky(START_COV) @ rng.standard_normal(3))
    estimator = make(name, START, START_COV)
    for _ in range(steps):
        error = np.linalg.cholesky(MOTION.cov) @ rng.standard_normal(3)
        true = true @ MOTION.motion @ Pose.from_array(error)
        estimator.predict(MOTION)
        estimator.update(BOTH.sight(true, range(len(BOTH.kinds)), rng))
    estimate, joint = joint_state(estimator)
    covs = landmark_covariances(joint)
    return nees_landmarks(estimate.landmarks, BOTH.landmarks[estimate.ids], estimate.walls, covs), estimate.walls


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_with_known_association_the_landmark_nees_is_in_its_chi_square_band_which_half_the_covariance_leaves(name):
    """Of points and of walls, one of each in every run: those of one run are correlated."""
    rows = []
    for seed in range(RUNS):
        nees, walls = landmark_nees(name, seed)
        rows.append([nees[~walls][seed % 2], nees[walls][seed % 2]])
    found, (low, high) = np.mean(rows, axis=0), nees_band(RUNS, dof=2, confidence=0.999)
    assert ((low < found) & (found < high)).all(), found
    assert (2.0 * found > high).all(), found
