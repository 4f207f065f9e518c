"""The parameters of a sensor of points on line: laws for all shipped estimators, and NEES."""

import numpy as np
import pytest

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation, predict_points
from sixthsense.core.motion import Odometry
from sixthsense.core.sensor import SENSOR_PARAMETERS, Sensor, SensorEstimate
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.estimation import assert_same, joint_state, make, noisy

ANGLES = np.linspace(-np.pi, np.pi, 12, endpoint=False)
POINTS = np.column_stack([5.0 * np.cos(ANGLES), 4.0 * np.sin(ANGLES)])
START = Pose(0.3, -0.2, 0.4)
PRIOR = SensorEstimate(Sensor(), np.diag([0.03, 0.1, 0.03]) ** 2)
TRUE = Sensor(0.02, -0.08, 0.03)
EACH = pytest.mark.parametrize("name", ESTIMATORS)


def reported(pose, ids, sensor, sigma, rng):
    """What a sensor reports of points from a pose, with noise `sigma`, m."""
    seen = predict_points(pose, POINTS[ids])[0]
    cov = sigma**2 * np.eye(2)
    return {
        i: Observation(Kind.CORNER, sensor.reported(z) + sigma * rng.standard_normal(2), cov)
        for i, z in zip(ids, seen, strict=True)
    }


def steps_of(sensor, sigma, steps, rng):
    """Motions of a drive about the origin, what a camera sees then, and the true pose after it."""
    at, cov = Pose(), np.diag([sigma, sigma, 0.5 * sigma]) ** 2
    for k in range(steps):
        motion = Odometry(Pose(0.2, 0.0, 0.3 if k % 16 < 12 else -0.5), cov)
        at = at @ noisy(motion, rng)
        ahead = predict_points(at, POINTS)[0]
        ids = np.flatnonzero(np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) < 0.8).tolist()
        yield motion, reported(at, ids, sensor, 2.0 * sigma, rng), at


def drive(name, sensor, prior, sigma, steps, rng):
    """An estimator after a drive, seen with `sensor`, and the true pose."""
    estimator = make(name, Pose(), 1e-2 * np.diag([sigma, sigma, 0.5 * sigma]) ** 2)
    estimator.estimate_sensor(prior)
    for motion, seen, true in steps_of(sensor, sigma, steps, rng):
        at = true
        estimator.predict(motion)
        present = estimator.sensor().values
        estimator.update({i: observation.with_sensor(present) for i, observation in seen.items()})
    return estimator, at


@EACH
def test_without_the_option_there_are_no_parameters(name):
    assert make(name).sensor() is None


@EACH
def test_before_any_motion_the_parameters_keep_their_prior(name):
    """A sensor that is turned or ahead sees new landmarks at other places; nothing tells which is the case."""
    estimator = make(name)
    estimator.estimate_sensor(SensorEstimate(TRUE, PRIOR.cov))
    seen = reported(START, [0, 2], TRUE, 0.01, np.random.default_rng(0))
    estimator.update({i: observation.with_sensor(TRUE) for i, observation in seen.items()})
    found = estimator.sensor()
    assert np.allclose(found.values.array(), TRUE.array(), atol=1e-9)
    assert np.allclose(found.cov, PRIOR.cov, rtol=1e-6, atol=1e-11)


@EACH
def test_an_exactly_known_sensor_is_that_of_observations_corrected_beforehand(name):
    known = SensorEstimate(TRUE, np.zeros((SENSOR_PARAMETERS, SENSOR_PARAMETERS)))
    estimator, _ = drive(name, TRUE, known, 0.01, 8, np.random.default_rng(3))
    plain = make(name, Pose(), 1e-2 * np.diag([0.01, 0.01, 0.005]) ** 2)
    for motion, seen, _ in steps_of(TRUE, 0.01, 8, np.random.default_rng(3)):
        plain.predict(motion)
        corrected = {i: observation.with_sensor(TRUE) for i, observation in seen.items()}
        plain.update({i: Observation(Kind.CORNER, seen.z, seen.cov) for i, seen in corrected.items()})
    assert_same(joint_state(plain), joint_state(estimator), 1e-4)


@EACH
def test_parameters_and_pose_converge_to_the_truth_as_noise_goes_to_zero(name):
    for sigma in (1e-3, 1e-4):
        estimator, true = drive(name, TRUE, PRIOR, sigma, 60, np.random.default_rng(1))
        assert np.abs(estimator.sensor().values.array() - TRUE.array()).max() < 20.0 * sigma
        assert np.linalg.norm(estimator.estimate().pose.position - true.position) < 30.0 * sigma


@EACH
def test_with_sensors_from_the_prior_pose_and_parameters_are_consistent(name):
    """Each run with another sensor."""
    runs, of_pose, of_sensor = 8 if name == "isam2" else 40, [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        sensor = Sensor.from_array(np.linalg.cholesky(PRIOR.cov) @ rng.standard_normal(SENSOR_PARAMETERS))
        estimator, true = drive(name, sensor, PRIOR, 0.01, 40, rng)
        estimate, found = estimator.estimate(), estimator.sensor()
        error = estimate.pose.array() - true.array()
        error[2] = wrap_angle(error[2])
        off = found.values.array() - sensor.array()
        of_pose.append(error @ np.linalg.solve(estimate.pose_cov, error))
        of_sensor.append(off @ np.linalg.solve(found.cov, off))
    for values, freedom in ((of_pose, 3), (of_sensor, SENSOR_PARAMETERS)):
        low, high = nees_band(runs, freedom, confidence=0.99)
        assert low < np.mean(values) < high


@EACH
def test_a_late_or_invalid_prior_is_refused(name):
    estimator = make(name)
    estimator.estimate_sensor(PRIOR)
    with pytest.raises(RuntimeError, match="estimate_sensor"):
        estimator.estimate_sensor(PRIOR)
    started = make(name)
    started.predict(Odometry(Pose(0.1), 1e-4 * np.eye(3)))
    with pytest.raises(RuntimeError, match="estimate_sensor"):
        started.estimate_sensor(PRIOR)
    for cov in (np.eye(2), -np.eye(SENSOR_PARAMETERS)):
        with pytest.raises(ValueError, match="prior of sensor"):
            make(name).estimate_sensor(SensorEstimate(Sensor(), cov))
