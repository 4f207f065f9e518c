"""Systematic errors of a sensor that names landmarks, as a camera does, and points corrected for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.parameters import ParameterEstimate

SENSOR_PARAMETERS = 2
"""number of a sensor's parameters"""


class Sensor(NamedTuple):
    """Systematic errors of the points that a sensor reports in the robot's frame: those of a camera's lens.

    A camera measures a depth along its axis, which both parameters keep: they move a point sideways. A scale of
    distances is not among them: only that of the wheels relative to the sensor's is observable.
    """

    bearing_scale_error: float = 0.0
    """tangents of true bearings are (1 + this) times those it reports, at the same depth, as by a wrong focal length"""
    centre_tangent: float = 0.0
    """tangent of the true bearing, from the sensor's axis, of what it reports there, as by a wrong principal point"""

    @classmethod
    def from_array(cls, values: Array) -> Sensor:
        """The parameters of two numbers, in the order of the fields."""
        return cls(*values.tolist())

    def array(self) -> Array:
        """(2,) in the order of the fields."""
        return np.array(self)

    def corrected(self, point: Array) -> tuple[Array, Array]:
        """A reported point (2,) corrected, and its Jacobian (2, 2) by the reported one."""
        by_point = np.array([[1.0, 0.0], [self.centre_tangent, 1.0 + self.bearing_scale_error]])
        return by_point @ point, by_point

    def reported(self, point: Array) -> Array:
        """The reported point (2,) of one that is corrected."""
        return np.array([point[0], (point[1] - self.centre_tangent * point[0]) / (1.0 + self.bearing_scale_error)])

    def jacobian(self, point: Array) -> Array:
        """(2, 2) of a corrected point by the parameters, for the reported point (2,)."""
        return np.array([[0.0, 0.0], [point[1], point[0]]])


@dataclass(frozen=True, slots=True)
class SensorTerms:
    """How the observation of a point depends on the sensor's parameters."""

    values: Sensor
    """the parameters that it was corrected with"""
    z: Array
    """(2,) as reported, robot's frame, m"""
    cov: Array
    """(2, 2) as reported"""

    def jacobian(self) -> Array:
        """(2, 2) of the corrected point by the parameters."""
        return self.values.jacobian(self.z)


_SIGMA = 0.03
"""of the scale of bearings and of the tangent of the centre before any observation: for a picture of 640 pixels, 60
degrees wide, 16 pixels"""


def sensor_prior() -> ParameterEstimate[Sensor]:
    """The prior of the parameters: neither is wrong, within 3 % and 0.03."""
    return ParameterEstimate(Sensor(), _SIGMA**2 * np.eye(SENSOR_PARAMETERS))
