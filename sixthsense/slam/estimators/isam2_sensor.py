"""Points in a factor graph as a sensor sees them whose mount and lens are a variable of it."""

from __future__ import annotations

import math

import gtsam
import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import Observation
from sixthsense.core.sensor import SENSOR_PARAMETERS, Sensor, SensorEstimate
from sixthsense.slam.estimators.isam2_factors import Loss, noise_of, with_loss
from sixthsense.slam.estimators.isam2_observations import point_factor

SENSOR = int(gtsam.symbol("s", 0))
"""key of the sensor's parameters, a vector"""
_FLOOR = 1e-6  # sigma added to each parameter: one that is known would make the system singular


def sensor_factor(prior: SensorEstimate) -> gtsam.NonlinearFactor:
    """The prior of the parameters."""
    noise = noise_of(prior.cov + _FLOOR**2 * np.eye(SENSOR_PARAMETERS))
    return gtsam.PriorFactorVector(SENSOR, prior.values.array(), noise)


def seen_point(
    point: int, pose: int, observation: Observation, sensor: Sensor | None, loss: Loss | None
) -> gtsam.NonlinearFactor:
    """The observation of a point as a factor between the variables with these keys, and those of the sensor if any."""
    if sensor is None:
        return point_factor(point, pose, observation, loss)
    terms = observation.with_sensor(sensor).sensor
    assert terms is not None
    bearing, distance, cov = Observation(observation.kind, terms.z, terms.cov).bearing_range()
    residual = Residual((pose, point), bearing, distance)
    return gtsam.CustomFactor(with_loss(noise_of(cov), loss), [pose, point, SENSOR], residual)


class Residual:
    """Predicted less reported bearing and distance, with its Jacobians; called by GTSAM."""

    def __init__(self, keys: tuple[int, int], bearing: float, distance: float) -> None:
        """Of the point with the second key, seen from the pose with the first one."""
        (self._pose, self._point), self._bearing, self._distance = keys, bearing, distance

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (2,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        pose, (px, py) = values.atPose2(self._pose), values.atPoint2(self._point)
        yaw, forward, scale_error = values.atVector(SENSOR)
        theta = pose.theta()
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = px - pose.x(), py - pose.y()
        x, y = c * dx + s * dy, c * dy - s * dx  # robot's frame
        off = x - forward
        distance, scale = max(math.hypot(off, y), 1e-9), 1.0 + scale_error
        bearing = wrap_angle(math.atan2(y, off) - yaw) / scale
        if jacobians is not None:
            along = np.array([off, y]) / distance
            by_point = np.array([[-along[1] / (distance * scale), along[0] / (distance * scale)], along])
            jacobians[0] = by_point @ np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            jacobians[1] = by_point @ np.array([[c, s], [-s, c]])
            jacobians[2] = np.column_stack([(-1.0 / scale, 0.0), -by_point[:, 0], (-bearing / scale, 0.0)])
        return np.array([wrap_angle(bearing - self._bearing), distance - self._distance])
