"""The sensor that names landmarks: corrected points, their Jacobians, and what is reported for a corrected point."""

import numpy as np

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.sensor import SENSOR_PARAMETERS, Sensor


def drawn(rng):
    point = rng.uniform([0.5, -1.0], [4.0, 1.0])
    return Sensor.from_array(rng.normal(size=SENSOR_PARAMETERS) * 0.1), point


def test_bearings_that_are_too_small_are_stretched_and_depths_kept():
    point, _ = Sensor(bearing_scale_error=0.05).corrected(np.array([2.0, 2.0 * np.tan(0.4)]))
    assert np.allclose(point, [2.0, 2.1 * np.tan(0.4)])


def test_the_reported_point_is_the_inverse_of_the_corrected_one():
    rng = np.random.default_rng(0)
    for _ in range(30):
        sensor, point = drawn(rng)
        assert np.allclose(sensor.reported(sensor.corrected(point)[0]), point, atol=1e-12)


def test_the_jacobians_of_a_corrected_point_agree_with_finite_differences():
    rng = np.random.default_rng(1)
    for _ in range(30):
        sensor, point = drawn(rng)
        by_point, by_sensor = sensor.corrected(point)[1], sensor.jacobian(point)
        for k, step in enumerate(1e-6 * np.eye(2)):
            slope = (sensor.corrected(point + step)[0] - sensor.corrected(point - step)[0]) / 2e-6
            assert np.allclose(slope, by_point[:, k], atol=1e-8)
        for k, step in enumerate(1e-6 * np.eye(SENSOR_PARAMETERS)):
            ahead, behind = (Sensor.from_array(sensor.array() + s).corrected(point)[0] for s in (step, -step))
            assert np.allclose((ahead - behind) / 2e-6, by_sensor[:, k], atol=1e-8)


def test_an_observation_is_corrected_from_what_was_reported_however_often_the_sensor_changes():
    reported = Observation(Kind.CORNER, np.array([2.0, 0.5]), np.diag([4e-3, 1e-3]))
    once = reported.with_sensor(Sensor(0.1, 0.03))
    again = reported.with_sensor(Sensor(0.3, 0.1)).with_sensor(Sensor(0.1, 0.03))
    assert np.array_equal(once.z, again.z) and np.array_equal(once.cov, again.cov)
    wall = Observation(Kind.WALL, np.array([0.3, 2.0]), np.diag([1e-4, 1e-4]))
    assert wall.with_sensor(Sensor(0.1, 0.03)) is wall
