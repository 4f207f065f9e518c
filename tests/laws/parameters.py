"""Laws of the parameters that filters and smoothers estimate on line: those of wheels, and of a sensor of points."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from point_world import POINTS, START, START_COV, assert_same, joint_state, make, noisy, sight
from predicted import predict_points

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.sensor import Sensor
from sixthsense.core.wheels import PARAMETERS, Wheels, corrected_with_terms
from sixthsense.slam.estimators import Filter
from sixthsense.testing import estimators as worlds
from sixthsense.testing.batch import Posterior, batch_posterior, to_robot
from sixthsense.testing.laws import Laws, raises

LAWS = Laws()
WALLS = Laws()

Values = Wheels | Sensor
Parameters = ParameterEstimate[Wheels] | ParameterEstimate[Sensor]

PRIOR = ParameterEstimate(Wheels(), np.diag([0.05, 0.05, 0.03]) ** 2)
TRUE = Wheels(0.03, -0.04, 0.02)
_TURNS = (0.3, 0.0, -0.35, 0.1)
_ANGLES = np.linspace(-np.pi, np.pi, 12, endpoint=False)
_RING = np.column_stack([5.0 * np.cos(_ANGLES), 4.0 * np.sin(_ANGLES)])


def increment(k: int, wheels: Wheels, cov: Array) -> Odometry:
    """The k-th motion that the wheels report, as odometry with these parameters and the covariance `cov` (3, 3)."""
    reported = Pose(0.2 + 0.1 * math.sin(0.7 * k), 0.01, _TURNS[(k // 6) % 4])
    motion, terms = corrected_with_terms(reported, wheels)
    return Odometry(motion, cov, terms)


class Kept:
    """What is estimated, with a prior, true values, and a drive on which they are observed."""

    label: str
    prior: Parameters
    true: Values

    def start(self, name: str, prior: Parameters | None = None, at: Pose = START, cov: Array = START_COV) -> Filter:
        """A new estimator that estimates the parameters."""
        estimator = make(name, at, cov)
        self.add(estimator, prior or self.prior)
        return estimator

    def drawn(self, rng: np.random.Generator) -> Values:
        """Values from the prior."""
        values = np.linalg.cholesky(self.prior.cov) @ rng.standard_normal(len(self.prior.cov))
        return type(self.true).from_array(values)

    def driven(
        self, name: str, steps: int, sigma: float, rng: np.random.Generator, true: Values | None = None
    ) -> tuple[Filter, Pose]:
        """An estimator after a drive with `true` values, and the true pose.

        `sigma` is that of motions in m, half of it in rad; that of observations follows it.
        """
        estimator = self.start(name, None, Pose(), 1e-2 * _motion_cov(sigma))
        return estimator, self.drive(estimator, steps, sigma, rng, true or self.true)

    def add(self, estimator: Filter, prior: Parameters) -> None:
        """Begin to estimate the parameters."""
        estimator.calibrate(prior)

    def found(self, estimator: Filter) -> Any:
        """The estimated parameters; None if they are not estimated."""
        return estimator.calibration(type(self.true))

    def look(self, estimator: Filter) -> None:
        """Observe two landmarks from the start with the true values."""
        raise NotImplementedError

    def drive(self, estimator: Filter, steps: int, sigma: float, rng: np.random.Generator, true: Values) -> Pose:
        """Drive among landmarks with `true` values; what is reported is taken by the present estimate, or as true."""
        raise NotImplementedError


def _motion_cov(sigma: float) -> Array:
    return np.diag([sigma, sigma, 0.5 * sigma]) ** 2


class OfWheels(Kept):
    """The wheels' parameters."""

    label, prior, true = "wheels", PRIOR, TRUE

    def look(self, estimator: Filter) -> None:
        estimator.update(sight(START, [0, 2], np.random.default_rng(0)))

    def drive(self, estimator: Filter, steps: int, sigma: float, rng: np.random.Generator, true: Values) -> Pose:
        at, cov = Pose(), _motion_cov(sigma)
        for k in range(steps):
            at = at @ noisy(increment(k, true, cov), rng)
            present = estimator.calibration(Wheels)
            estimator.predict(increment(k, true if present is None else present.values, cov))
            seen = rng.choice(len(POINTS), 3, replace=False).tolist()
            estimator.update(sight(at, seen, rng, 5.0 * sigma))
        return at


class OfSensor(Kept):
    """The parameters of a sensor of points."""

    label, prior, true = (
        "sensor",
        ParameterEstimate(Sensor(), np.diag([0.03, 0.03]) ** 2),
        Sensor(0.03, -0.02),
    )

    def look(self, estimator: Filter) -> None:
        seen = self._reported(START, [0, 2], self.true, 0.01, np.random.default_rng(0))
        estimator.update({i: observation.with_sensor(self.true) for i, observation in seen.items()})

    def drive(self, estimator: Filter, steps: int, sigma: float, rng: np.random.Generator, true: Values) -> Pose:
        at = Pose()
        for k in range(steps):
            motion = Odometry(Pose(0.2, 0.0, 0.3 if k % 16 < 12 else -0.5), _motion_cov(sigma))
            at = at @ noisy(motion, rng)
            estimator.predict(motion)
            ahead = predict_points(at, _RING)[0]
            ids = np.flatnonzero(np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) < 0.8).tolist()
            seen = self._reported(at, ids, true, 2.0 * sigma, rng)
            present = estimator.calibration(Sensor)
            taken = {i: s.with_sensor(true if present is None else present.values) for i, s in seen.items()}
            plain = {i: Observation(Kind.CORNER, s.z, s.cov) for i, s in taken.items()}
            estimator.update(plain if present is None else taken)
        return at

    def _reported(
        self, pose: Pose, ids: list[int], sensor: Sensor, sigma: float, rng: np.random.Generator
    ) -> dict[LandmarkId, Observation]:
        """What a sensor reports of points from a pose, with noise `sigma`, m."""
        seen, cov = predict_points(pose, _RING[ids])[0], sigma**2 * np.eye(2)
        return {
            i: Observation(Kind.CORNER, sensor.reported(z) + sigma * rng.standard_normal(2), cov)
            for i, z in zip(ids, seen, strict=True)
        }


WHEELS, KINDS = OfWheels(), (OfWheels(), OfSensor())


@LAWS.law(None, KINDS)
def without_the_option_there_are_no_parameters(name: str, kind: Kept) -> None:
    assert kind.found(make(name)) is None


@LAWS.law(None, KINDS)
def before_any_motion_the_parameters_keep_their_prior(name: str, kind: Kept) -> None:
    """Nothing tells whether the sensor is turned, or the landmarks lie elsewhere."""
    estimator = kind.start(name, dataclasses.replace(kind.prior, values=kind.true))
    kind.look(estimator)
    found = kind.found(estimator)
    assert np.allclose(found.values.array(), kind.true.array(), rtol=0.0, atol=1e-9)
    assert np.allclose(found.cov, kind.prior.cov, rtol=1e-6, atol=1e-11)


@LAWS.law(None, KINDS)
def exactly_known_parameters_change_nothing(name: str, kind: Kept) -> None:
    known = dataclasses.replace(kind.prior, values=kind.true, cov=np.zeros_like(kind.prior.cov))
    at, cov = Pose(), 1e-2 * _motion_cov(0.01)
    plain, estimator = make(name, at, cov), kind.start(name, known, at, cov)
    for each in (plain, estimator):
        kind.drive(each, 8, 0.01, np.random.default_rng(3), kind.true)
    assert_same(joint_state(plain), joint_state(estimator), 1e-4)


@LAWS.law(None, KINDS)
def parameters_and_pose_converge_to_the_truth_as_noise_goes_to_zero(name: str, kind: Kept) -> None:
    for sigma in (1e-3, 1e-4):
        estimator, true = kind.driven(name, 60, sigma, np.random.default_rng(1))
        found = kind.found(estimator)
        assert np.abs(found.values.array() - kind.true.array()).max() < 20.0 * sigma
        assert np.linalg.norm(estimator.estimate().pose.position - true.position) < 30.0 * sigma


@LAWS.law(None, KINDS)
def a_late_or_invalid_prior_is_refused(name: str, kind: Kept) -> None:
    late = f"calibrate {kind.label}"
    with raises(RuntimeError, late):
        kind.add(kind.start(name), kind.prior)
    moved, seen = make(name), make(name)
    moved.predict(Odometry(Pose(0.1), 1e-4 * np.eye(3)))
    seen.update(sight(START, [0], np.random.default_rng(0)))
    for estimator in (moved, seen):
        with raises(RuntimeError, late):
            kind.add(estimator, kind.prior)
    n = len(kind.prior.cov)
    for cov in (np.eye(n - 1), -np.eye(n), np.full((n, n), np.nan)):
        with raises(ValueError, f"prior of {kind.label}"):
            kind.start(name, dataclasses.replace(kind.prior, cov=cov))


@LAWS.law(None, [worlds.POINTS, worlds.BOTH])
def a_drive_with_uncertain_wheels_gives_the_posterior_of_batch_least_squares(name: str, world: worlds.World) -> None:
    noise, rng = worlds.NOISE, np.random.default_rng(7)
    prior = ParameterEstimate(Wheels(0.02, 0.01, -0.01), (4.0 * noise) ** 2 * np.eye(PARAMETERS))
    true = Wheels.from_array(prior.values.array() + 4.0 * noise * rng.standard_normal(PARAMETERS))
    at = Pose.from_array(worlds.START.array() + np.linalg.cholesky(worlds.START_COV) @ rng.standard_normal(3))
    log: list[tuple[Odometry, dict[LandmarkId, Observation]]] = []
    estimator = WHEELS.start(name, prior, worlds.START, worlds.START_COV)
    for k in range(8):
        error = np.linalg.cholesky(worlds.MOTION.cov) @ rng.standard_normal(3)
        at = at @ increment(k, true, worlds.MOTION.cov).motion @ Pose.from_array(error)
        ids = range(len(world.kinds)) if k % 3 != 1 else [k % 2, 2]
        log.append((increment(k, prior.values, worlds.MOTION.cov), world.sight(at, list(ids), rng)))
        estimator.predict(log[-1][0])
        estimator.update(log[-1][1])
    found = batch_posterior(log, worlds.START, worlds.START_COV, prior)
    rest, wheels = slice(0, -PARAMETERS), slice(-PARAMETERS, None)
    reference = Posterior(found.ids, found.mean[rest], found.cov[rest, rest], found.angles[rest])
    worlds.assert_agrees(estimator, reference)
    estimate, tolerance = WHEELS.found(estimator), 2.0 * worlds.TOLERANCE
    sigmas = np.sqrt(np.diag(found.cov)[wheels])
    assert np.abs((estimate.values.array() - found.mean[wheels]) / sigmas).max() < tolerance
    assert np.abs((estimate.cov - found.cov[wheels, wheels]) / np.outer(sigmas, sigmas)).max() < tolerance


@WALLS.law()
def between_two_walls_without_an_end_the_forward_scale_keeps_its_prior(name: str) -> None:
    """The drift is observed there. A drive across would observe the scale, too.

    The angles' noise times the way is small beside the noise of the offsets: walls that seem to meet ahead would tell
    the scale.
    """
    rng, at, true = np.random.default_rng(2), Pose(0.0, 0.2, 0.0), Wheels(0.03, 0.0, 0.0)
    walls = np.array([[-0.5 * math.pi, -1.0], [0.5 * math.pi, -1.0]])  # normals towards the robot
    cov, seen = np.diag([5e-3, 5e-3, 1e-3]) ** 2, np.diag([1e-4, 3e-3]) ** 2
    estimator = WHEELS.start(name, PRIOR, at, np.zeros((3, 3)))
    for _ in range(40):
        reported = Pose(0.25, 0.0, -0.5 * at.theta)
        at = at @ noisy(Odometry(corrected_with_terms(reported, true)[0], cov), rng)
        motion, terms = corrected_with_terms(reported, WHEELS.found(estimator).values)
        estimator.predict(Odometry(motion, cov, terms))
        observations = {}
        for i, wall in enumerate(walls):
            z = to_robot(at.array(), wall, True) + np.linalg.cholesky(seen) @ rng.standard_normal(2)
            observations[i] = Observation(Kind.WALL, z, seen, (-2.0, 2.0))
        estimator.update(observations)
    found, prior = WHEELS.found(estimator), np.sqrt(np.diag(PRIOR.cov))
    sigmas = np.sqrt(np.diag(found.cov))
    assert sigmas[0] > 0.98 * prior[0] and abs(found.values.forward_scale_error) < 0.3 * prior[0]
    assert sigmas[2] < 0.1 * prior[2] and abs(found.values.drift_rad_per_m) < 4.0 * sigmas[2]
