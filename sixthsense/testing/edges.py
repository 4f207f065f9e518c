"""Edge cases of the contract: invalid input, exact knowledge, zero noise, long drives without observations."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.testing.estimation import (
    POINTS,
    START,
    assert_same,
    driven,
    fed,
    joint_state,
    make,
    noisy,
    random_log,
    sight,
    sight_exactly,
    step,
)
from sixthsense.testing.laws import Laws, raises

LAWS, VALIDATION = Laws(), Laws("validation")

BAD_POSE_COVS = {
    "a value that is not finite": np.diag([0.01, np.nan, 0.01]),
    "not finite": np.diag([0.01, np.inf, 0.01]),
    "an asymmetric matrix": np.diag([0.01, 0.01, 0.01]) + np.array([[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]]),
    "an eigenvalue of -0.01": np.diag([0.01, -0.01, 0.01]),
    r"expected shape \(3, 3\), got \(2, 2\)": np.eye(2),
}
BAD_OBSERVATIONS = {
    "a value that is not finite": ([1.0, 2.0], [[0.01, np.nan], [np.nan, 0.01]]),
    "not finite": ([1.0, 2.0], [[np.inf, 0.0], [0.0, 0.01]]),
    "an asymmetric matrix": ([1.0, 2.0], [[0.01, 1e-3], [0.0, 0.01]]),
    "an eigenvalue of -0.01": ([1.0, 2.0], [[0.01, 0.02], [0.02, 0.01]]),
    "an eigenvalue of -1": ([1.0, 2.0], [[-1.0, 0.0], [0.0, -1.0]]),
    "a singular covariance": ([1.0, 2.0], [[0.01, 0.0], [0.0, 0.0]]),
    "singular|an eigenvalue of .*e-": ([1.0, 2.0], [[0.01, 0.01], [0.01, 0.01]]),
    "landmark 7: found z": ([np.nan, 2.0], [[0.01, 0.0], [0.0, 0.01]]),
    r"expected z \(2,\)": ([1.0, 2.0, 3.0], [[0.01, 0.0], [0.0, 0.01]]),
}


@VALIDATION.law_for(BAD_POSE_COVS)
def an_invalid_start_covariance_is_named(name: str, fault: str) -> None:
    with raises(ValueError, f"start_cov: .*{fault}"):
        make(name, START, BAD_POSE_COVS[fault])


@VALIDATION.law_for(BAD_POSE_COVS)
def an_invalid_odometry_covariance_is_named_and_changes_nothing(name: str, fault: str) -> None:
    estimator = driven(name)
    before = joint_state(estimator)
    for motion in (Pose(0.1, 0.0, 0.0), Pose()):
        with raises(ValueError, f"odometry: .*{fault}"):
            estimator.predict(Odometry(motion, BAD_POSE_COVS[fault]))
        assert_same(before, joint_state(estimator))


@VALIDATION.law_for(BAD_OBSERVATIONS)
def an_invalid_observation_is_named_and_changes_nothing(name: str, fault: str) -> None:
    """The valid observations of the same scan are rejected as well."""
    estimator = driven(name)
    before, rows = joint_state(estimator), estimator.trajectory()
    z, cov = BAD_OBSERVATIONS[fault]
    good = sight(Pose(1.0, 1.0, 1.0), [0, 1, 2], np.random.default_rng(0))
    for i in (7, 1):
        bad = {i: Observation(Kind.CORNER, np.array(z), np.array(cov))}
        with raises(ValueError, fault.replace("landmark 7", f"landmark {i}")):
            estimator.update(good | bad if i == 7 else bad)
        assert_same(before, joint_state(estimator))
        assert np.array_equal(rows, estimator.trajectory())
    estimator.update(good)
    assert len(estimator.trajectory()) == 9


@VALIDATION.law
def the_error_of_an_observation_names_its_landmark(name: str) -> None:
    good = sight(START, [0, 1, 2], np.random.default_rng(0))
    with raises(ValueError, "landmark 41: found an asymmetric matrix, allowed: a covariance, symmetric"):
        make(name).update(good | {41: Observation(Kind.END, np.ones(2), np.array([[1.0, 0.5], [0.0, 1.0]]))})


@LAWS.law
def an_exact_motion_moves_the_pose_and_transports_its_covariance(name: str) -> None:
    estimator = driven(name)
    before = estimator.estimate()
    estimator.predict(Odometry(Pose(0.5, 0.1, 0.2), np.zeros((3, 3))))
    after = estimator.estimate()
    assert np.allclose(after.pose.array(), (before.pose @ Pose(0.5, 0.1, 0.2)).array(), atol=1e-12)
    assert np.isclose(after.pose_cov[2, 2], before.pose_cov[2, 2], rtol=1e-6)
    assert np.isclose(np.linalg.det(after.pose_cov), np.linalg.det(before.pose_cov), rtol=1e-6)
    estimator.update(sight(after.pose, [0, 1, 2], np.random.default_rng(0)))
    assert np.linalg.eigvalsh(joint_state(estimator)[1]).min() > 0.0


@LAWS.law
def every_update_without_observations_adds_a_pose_to_the_trajectory(name: str) -> None:
    """The estimate is that of odometry alone, and later observations are used as usual."""
    estimator, folded, rows = make(name), STANDSTILL, []
    for k in range(300):
        if k % 3:
            estimator.predict(step())
            folded = folded.then(step())
        estimator.update({})
        rows.append((START @ folded.motion).array())
    assert np.allclose(estimator.trajectory(), rows, atol=1e-9)
    alone = make(name)
    alone.predict(folded)
    assert_same(joint_state(estimator), joint_state(alone), 1e-9)
    expected = START @ folded.motion
    for k in range(3):
        estimator.update(sight(expected, range(5), np.random.default_rng(k)))
    assert estimator.trajectory().shape == (303, 3)
    estimate, joint = joint_state(estimator)
    assert np.linalg.eigvalsh(joint).min() > 0.0
    assert np.allclose(estimator.trajectory()[-1], estimate.pose.array())


@LAWS.law
def the_trajectory_has_one_row_per_update_and_starts_empty(name: str) -> None:
    estimator = make(name)
    assert estimator.trajectory().shape == (0, 3)
    rng = np.random.default_rng(0)
    for k in range(70):
        estimator.predict(step())
        estimator.update(sight(START, [0, 1], rng) if k % 7 == 3 else {})
        rows = estimator.trajectory()
        assert rows.shape == (k + 1, 3)
        assert np.allclose(rows[-1], estimator.estimate().pose.array(), atol=1e-12)


@LAWS.law_for([step(), step(0.0, 0.3), step(0.3, 0.0), Odometry(Pose(), np.zeros((3, 3)))])
def a_drive_from_an_exact_start_never_fails(name: str, motion: Odometry) -> None:
    estimator, true = make(name, Pose(), np.zeros((3, 3))), Pose()
    for _ in range(30):
        estimator.predict(motion)
        true = true @ motion.motion
        estimator.update(sight_exactly(name, true, range(5)))
    estimate, joint = joint_state(estimator)
    assert np.isfinite(joint).all() and np.linalg.eigvalsh(joint).min() > -1e-12
    assert np.allclose(estimate.pose.position, true.position, atol=1e-6)


@LAWS.law_for([1e-2, 1e-4, 1e-6])
def the_estimate_converges_to_the_truth_as_the_noise_goes_to_zero(name: str, sigma: float) -> None:
    rng = np.random.default_rng(1)
    estimator, true = make(name, Pose(), np.zeros((3, 3))), Pose()
    for _ in range(40):
        odometry = step(sigma=sigma)
        true = true @ noisy(odometry, rng)
        estimator.predict(odometry)
        estimator.update(sight(true, range(5), rng, sigma))
    estimate = estimator.estimate()
    assert math.dist(estimate.pose.position, true.position) < 5 * sigma
    assert abs(wrap_angle(estimate.pose.theta - true.theta)) < 5 * sigma
    order = np.argsort(estimate.ids)
    assert np.abs(estimate.landmarks[order] - POINTS).max() < 5 * sigma


@LAWS.law
def a_long_random_drive_keeps_the_joint_covariance_positive_definite(name: str) -> None:
    points = np.random.default_rng(3).uniform(-5, 5, (30, 2))
    estimate, joint = joint_state(fed(make(name), random_log(2, points)))
    assert len(estimate.ids) == 30 and np.linalg.eigvalsh(joint).min() > 0.0
