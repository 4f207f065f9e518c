"""NEES of landmarks: 2 if consistent, where the true wall or point is known."""

import dataclasses
import math

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.matches import landmark_identities
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import nees_band, nees_landmarks
from sixthsense.evaluation.true_identities import TrueLaser, true_identities
from sixthsense.loop import run
from sixthsense.testing.estimation import joint_state, make
from sixthsense.testing.posterior import BOTH, MOTION, START, START_COV

RUNS = 150


def landmark_nees(name, seed, cov_factor=1.0, steps=6):
    """(n,) NEES of all points and walls after a drive with known association, and which are walls."""
    rng = np.random.default_rng(seed)
    true = Pose.from_array(START.array() + np.linalg.cholesky(START_COV) @ rng.standard_normal(3))
    estimator = make(name, START, START_COV)
    for _ in range(steps):
        error = np.linalg.cholesky(MOTION.cov) @ rng.standard_normal(3)
        true = true @ Pose.from_array(MOTION.motion.array() + error)
        estimator.predict(MOTION)
        estimator.update(BOTH.sight(true, range(len(BOTH.kinds)), rng))
    estimate, joint = joint_state(estimator)
    covs = cov_factor * np.array([joint[k : k + 2, k : k + 2] for k in range(3, len(joint), 2)])
    return nees_landmarks(estimate.landmarks, BOTH.landmarks[estimate.ids], estimate.walls, covs), estimate.walls


def means(name, cov_factor=1.0):
    """Mean over runs for points and for walls, one of each in every run: those of one run are correlated."""
    rows = []
    for seed in range(RUNS):
        nees, walls = landmark_nees(name, seed, cov_factor)
        rows.append([nees[~walls][seed % 2], nees[walls][seed % 2]])
    return np.mean(rows, axis=0)


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_with_known_association_the_landmark_nees_is_in_its_chi_square_band(name):
    low, high = nees_band(RUNS, dof=2, confidence=0.999)
    found = means(name)
    assert ((low < found) & (found < high)).all(), found


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_half_the_landmark_covariance_leaves_that_band(name):
    _, high = nees_band(RUNS, dof=2, confidence=0.999)
    found = means(name, cov_factor=0.5)
    assert (found > high).all(), found


def test_the_angle_of_a_wall_is_wrapped_and_the_coordinate_of_a_point_is_not():
    estimate = np.array([[math.pi - 0.01, 2.0], [math.pi, 2.0]])
    truth = np.array([[-math.pi + 0.01, 2.0], [-math.pi, 2.0]])
    found = nees_landmarks(estimate, truth, np.array([True, False]), np.stack([np.eye(2) * 1e-4] * 2))
    np.testing.assert_allclose(found, [4.0, 4.0e4 * math.pi**2], rtol=1e-3)


@pytest.fixture(scope="module")
def tour():
    return run(preset(scene="apartment", task="tour", max_time=30.0, seed=3, estimator="ekf-invariant"))


def test_a_run_measures_the_nees_of_the_landmarks_whose_truth_is_known(tour):
    scene = true_identities(tour.scene.walls)
    laser = TrueLaser(tour.config.laser, tour.config.assumed.laser)
    scans = [association.observations for association in tour.associations]
    identities = landmark_identities(scans, np.array(tour.key_truths), scene, laser)
    expected = []
    for k, i in enumerate(tour.final.ids.tolist()):
        if i in identities:
            error = tour.final.landmarks[k] - scene.landmark(identities[i])
            if tour.final.walls[k]:
                error[0] = math.remainder(error[0], 2.0 * math.pi)
            block = tour.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
            expected.append(error @ np.linalg.inv(block) @ error)
    assert len(expected) > 0.9 * len(tour.final.ids)
    assert measure(tour)["landmark_nees_mean"] == pytest.approx(np.mean(expected), rel=0.01)  # to first order


def test_the_true_normal_of_a_wall_points_to_the_side_that_the_robot_saw(tour):
    scene = true_identities(tour.scene.walls)
    laser = TrueLaser(tour.config.laser, tour.config.assumed.laser)
    scans = [association.observations for association in tour.associations]
    identities = landmark_identities(scans, np.array(tour.key_truths), scene, laser)
    sides = {"front": 0, "back": 0}
    for k, i in enumerate(tour.final.ids.tolist()):
        if tour.final.walls[k] and i in identities:
            off = tour.final.landmarks[k] - scene.landmark(identities[i])
            assert abs(math.remainder(off[0], 2.0 * math.pi)) < 0.2
            sides[identities[i][0]] += 1
    assert min(sides.values()) > 5


def test_without_the_returns_of_the_observations_no_truth_is_known(tour):
    def forgotten(association):
        seen = {i: dataclasses.replace(s, bearings=np.empty(0)) for i, s in association.observations.items()}
        return dataclasses.replace(association, observations=seen)

    loaded = dataclasses.replace(tour, associations=[forgotten(association) for association in tour.associations])
    assert "landmark_nees_mean" not in measure(loaded)
