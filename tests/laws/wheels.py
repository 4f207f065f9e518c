"""Laws of `estimate_wheels` and `wheels` of filters and smoothers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.wheels import PARAMETERS, WheelEstimate, Wheels, corrected_with_terms
from sixthsense.slam.estimators import Filter
from sixthsense.testing import posterior
from sixthsense.testing.batch import Posterior, batch_posterior, to_robot
from sixthsense.testing.estimation import POINTS, START, START_COV, assert_same, joint_state, make, noisy, sight
from sixthsense.testing.laws import Laws, raises

LAWS = Laws()

PRIOR = WheelEstimate(Wheels(), np.diag([0.05, 0.05, 0.03, 0.05, 0.03]) ** 2)
TRUE = Wheels(0.03, -0.04, 0.02, 0.05, 0.02)
_PERIOD_S = 0.5
_TURNS = (0.3, 0.0, -0.35, 0.1)


def increment(k: int, wheels: Wheels, cov: Array) -> Odometry:
    """The k-th motion that the wheels report, as odometry with these parameters and the covariance `cov` (3, 3)."""
    reported, before = (
        np.array([0.2 + 0.1 * math.sin(0.7 * i), 0.01, _TURNS[(i // 6) % 4]]) for i in (k, max(k - 1, 0))
    )
    change = (reported - before) / _PERIOD_S
    at_stamp, terms = corrected_with_terms(Pose.from_array(reported), wheels, change)
    return Odometry(Pose.from_array(at_stamp.array() + wheels.latency_s * change), cov, terms)


def calibrating(name: str, prior: WheelEstimate = PRIOR, start: Pose = START, start_cov: Array = START_COV) -> Filter:
    """A new estimator that estimates the wheels' parameters."""
    estimator = make(name, start, start_cov)
    assert isinstance(estimator, Filter)
    estimator.estimate_wheels(prior)
    return estimator


def estimate_of(estimator: Filter) -> WheelEstimate:
    """The estimated parameters."""
    found = estimator.wheels()
    assert found is not None, "wheels returned None after estimate_wheels"
    return found


def calibrated(
    name: str, steps: int, sigma: float, rng: np.random.Generator, true: Wheels = TRUE
) -> tuple[Filter, Pose]:
    """An estimator after a drive among points with the wheels `true`, and the true pose.

    `sigma` is that of motions in m, half of it in rad, and a fifth of that of observations. Odometry follows the
    estimate.
    """
    at, cov = Pose(), np.diag([sigma, sigma, 0.5 * sigma]) ** 2
    estimator = calibrating(name, PRIOR, at, 1e-2 * cov)
    for k in range(steps):
        at = at @ noisy(increment(k, true, cov), rng)
        estimator.predict(increment(k, estimate_of(estimator).values, cov))
        seen = rng.choice(len(POINTS), 3, replace=False).tolist()
        estimator.update(sight(at, seen, rng, 5.0 * sigma))
    return estimator, at


@LAWS.law
def without_the_option_there_are_no_parameters(name: str) -> None:
    estimator = make(name)
    assert isinstance(estimator, Filter) and estimator.wheels() is None


@LAWS.law
def before_any_motion_the_parameters_are_their_prior(name: str) -> None:
    prior = WheelEstimate(TRUE, PRIOR.cov)
    estimator = calibrating(name, prior)
    estimator.update(sight(START, [0, 2], np.random.default_rng(0)))
    found = estimate_of(estimator)
    assert np.allclose(found.values.array(), TRUE.array(), rtol=0.0, atol=1e-9)
    assert np.allclose(found.cov, PRIOR.cov, rtol=1e-6, atol=1e-12)


@LAWS.law
def exactly_known_wheels_change_nothing(name: str) -> None:
    plain, known = make(name), calibrating(name, WheelEstimate(TRUE, np.zeros((PARAMETERS, PARAMETERS))))
    for estimator in (plain, known):
        rng, at = np.random.default_rng(4), START
        for k in range(8):
            at = at @ increment(k, TRUE, np.eye(3)).motion
            estimator.predict(increment(k, TRUE, 1e-4 * np.eye(3)))
            estimator.update(sight(at, [k % 5, (k + 1) % 5], rng))
        estimator.predict(increment(8, TRUE, 1e-4 * np.eye(3)))
    assert_same(joint_state(plain), joint_state(known), 1e-4)


@LAWS.law
def odometry_that_does_not_depend_on_the_wheels_leaves_them_alone(name: str) -> None:
    plain, other = make(name), calibrating(name)
    for estimator in (plain, other):
        rng, at = np.random.default_rng(4), START
        for k in range(8):
            motion = dataclasses.replace(increment(k, TRUE, 1e-4 * np.eye(3)), wheels=None)
            at = at @ motion.motion
            estimator.predict(motion)
            estimator.update(sight(at, [k % 5, (k + 1) % 5], rng))
    assert_same(joint_state(plain), joint_state(other), 1e-6)
    assert np.allclose(estimate_of(other).cov, PRIOR.cov, rtol=1e-6, atol=1e-12)


@LAWS.law_for([posterior.POINTS, posterior.BOTH])
def a_drive_with_uncertain_wheels_gives_the_posterior_of_batch_least_squares(name: str, world: posterior.World) -> None:
    noise, rng = posterior.NOISE, np.random.default_rng(7)
    prior = WheelEstimate(Wheels(0.02, 0.01, -0.01, 0.03), (4.0 * noise) ** 2 * np.eye(PARAMETERS))
    true = Wheels.from_array(prior.values.array() + 4.0 * noise * rng.standard_normal(PARAMETERS))
    at = Pose.from_array(posterior.START.array() + np.linalg.cholesky(posterior.START_COV) @ rng.standard_normal(3))
    log: list[tuple[Odometry, dict[LandmarkId, Observation]]] = []
    estimator = calibrating(name, prior, posterior.START, posterior.START_COV)
    for k in range(8):
        error = np.linalg.cholesky(posterior.MOTION.cov) @ rng.standard_normal(3)
        at = at @ Pose.from_array(increment(k, true, posterior.MOTION.cov).motion.array() + error)
        ids = range(len(world.kinds)) if k % 3 != 1 else [k % 2, 2]
        log.append((increment(k, prior.values, posterior.MOTION.cov), world.sight(at, list(ids), rng)))
        estimator.predict(log[-1][0])
        estimator.update(log[-1][1])
    found = batch_posterior(log, posterior.START, posterior.START_COV, prior)
    rest, wheels = slice(0, -PARAMETERS), slice(-PARAMETERS, None)
    reference = Posterior(found.ids, found.mean[rest], found.cov[rest, rest], found.angles[rest])
    posterior.assert_agrees(estimator, reference)
    estimate, tolerance = estimate_of(estimator), 2.0 * posterior.TOLERANCE
    sigmas = np.sqrt(np.diag(found.cov)[wheels])
    assert np.abs((estimate.values.array() - found.mean[wheels]) / sigmas).max() < tolerance
    assert np.abs((estimate.cov - found.cov[wheels, wheels]) / np.outer(sigmas, sigmas)).max() < tolerance


@LAWS.law
def parameters_and_pose_converge_to_the_truth_as_noise_goes_to_zero(name: str) -> None:
    for sigma in (1e-3, 1e-4):
        estimator, true = calibrated(name, 60, sigma, np.random.default_rng(1))
        estimate, wheels = estimator.estimate(), estimate_of(estimator)
        assert np.abs(wheels.values.array() - TRUE.array()).max() < 10.0 * sigma
        assert np.linalg.norm(estimate.pose.position - true.position) < 30.0 * sigma


@LAWS.wall_law
def between_two_walls_without_an_end_the_forward_scale_keeps_its_prior(name: str) -> None:
    """The drift is observed there. A drive across would observe the scale, too.

    Filters with first-estimates Jacobians take a wall's first angle for its angle: two walls that seem to meet ahead
    tell them the scale. So the angles' noise times the way is small beside the noise of the offsets.
    """
    rng, at, true = np.random.default_rng(2), Pose(0.0, 0.2, 0.0), Wheels(0.03, 0.0, 0.0)
    walls = np.array([[-0.5 * math.pi, -1.0], [0.5 * math.pi, -1.0]])  # normals towards the robot
    cov, seen = np.diag([5e-3, 5e-3, 1e-3]) ** 2, np.diag([1e-4, 3e-3]) ** 2
    estimator = calibrating(name, PRIOR, at, np.zeros((3, 3)))
    for _ in range(40):
        reported = Pose(0.25, 0.0, -0.5 * at.theta)
        at = at @ noisy(Odometry(corrected_with_terms(reported, true, np.zeros(3))[0], cov), rng)
        motion, terms = corrected_with_terms(reported, estimate_of(estimator).values, np.zeros(3))
        estimator.predict(Odometry(motion, cov, terms))
        observations = {}
        for i, wall in enumerate(walls):
            z = to_robot(at.array(), wall, True) + np.linalg.cholesky(seen) @ rng.standard_normal(2)
            observations[i] = Observation(Kind.WALL, z, seen, (-2.0, 2.0))
        estimator.update(observations)
    found, prior = estimate_of(estimator), np.sqrt(np.diag(PRIOR.cov))
    sigmas = np.sqrt(np.diag(found.cov))
    assert sigmas[0] > 0.98 * prior[0] and abs(found.values.forward_scale_error) < 0.3 * prior[0]
    assert sigmas[2] < 0.1 * prior[2] and abs(found.values.drift_rad_per_m) < 4.0 * sigmas[2]


@LAWS.law
def the_estimate_of_wheels_is_a_copy(name: str) -> None:
    estimator, _ = calibrated(name, 5, 0.01, np.random.default_rng(0))
    before = estimate_of(estimator).cov.copy()
    estimate_of(estimator).cov[:] = 7.0
    assert np.array_equal(estimate_of(estimator).cov, before)


@LAWS.law
def a_late_or_invalid_prior_is_refused(name: str) -> None:
    with raises(RuntimeError, "estimate_wheels"):
        calibrating(name).estimate_wheels(PRIOR)
    started = make(name)
    assert isinstance(started, Filter)
    started.update(sight(START, [0], np.random.default_rng(0)))
    with raises(RuntimeError, "estimate_wheels"):
        started.estimate_wheels(PRIOR)
    for cov in (np.eye(3), -np.eye(PARAMETERS), np.full((PARAMETERS, PARAMETERS), np.nan)):
        with raises(ValueError, "prior of wheels"):
            calibrating(name, WheelEstimate(Wheels(), cov))
