"""Systematic errors of a sensor that names landmarks, as a camera does, and points corrected for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array, rotation
from sixthsense.core.parameters import ParameterEstimate

SENSOR_PARAMETERS = 4
"""number of a sensor's parameters"""


class Sensor(NamedTuple):
    """Systematic errors of the points that a sensor reports in the robot's frame: those of its mount and lens.

    A scale of distances is not among them: only that of the wheels relative to the sensor's is observable.
    """

    yaw_rad: float = 0.0
    """direction of the sensor in the robot's frame, beyond the assumed one"""
    forward_m: float = 0.0
    """place of the sensor along the robot's x axis, beyond the assumed one"""
    bearing_scale_error: float = 0.0
    """tangents of true bearings are (1 + this) times those it reports, at the same depth, as by a wrong focal length"""
    centre_tangent: float = 0.0
    """tangent of the true bearing, from the sensor's axis, of what it reports there, as by a wrong principal point"""

    @classmethod
    def from_array(cls, values: Array) -> Sensor:
        """The parameters of four numbers, in the order of the fields."""
        return cls(*values.tolist())

    def array(self) -> Array:
        """(4,) in the order of the fields."""
        return np.array(self)

    def corrected(self, point: Array) -> tuple[Array, Array]:
        """A reported point (2,) corrected, and its Jacobian (2, 2) by the reported one.

        A camera measures a depth along its axis, which its focal length leaves to the scale, and its principal point
        leaves alone: both move a point sideways. So a wrong principal point is not a yaw, which turns the axis, too.
        """
        by_point = rotation(self.yaw_rad) @ self._sideways()
        return by_point @ point + np.array([self.forward_m, 0.0]), by_point

    def reported(self, point: Array) -> Array:
        """The reported point (2,) of one that is corrected."""
        seen = (point - np.array([self.forward_m, 0.0])) @ rotation(self.yaw_rad)
        return np.array([seen[0], (seen[1] - self.centre_tangent * seen[0]) / (1.0 + self.bearing_scale_error)])

    def jacobian(self, point: Array) -> Array:
        """(2, 4) of a corrected point by the parameters, for the reported point (2,)."""
        turn = rotation(self.yaw_rad)
        x, y = (turn @ self._sideways() @ point).tolist()
        return np.column_stack([(-y, x), (1.0, 0.0), point[1] * turn[:, 1], point[0] * turn[:, 1]])

    def _sideways(self) -> Array:
        """(2, 2) what the lens moves sideways, axes of the sensor."""
        return np.array([[1.0, 0.0], [self.centre_tangent, 1.0 + self.bearing_scale_error]])


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
        """(2, 4) of the corrected point by the parameters."""
        return self.values.jacobian(self.z)


_SIGMAS = 0.03, 0.1, 0.03, 0.03
"""rad of the yaw, m of the place, the scale of bearings and the tangent of the centre before any observation: for a
picture of 640 pixels, 60 degrees wide, 16 pixels"""


def sensor_prior() -> ParameterEstimate[Sensor]:
    """The prior of the parameters: none is wrong, within 0.03 rad, 0.1 m, 3 % and 0.03."""
    return ParameterEstimate(Sensor(), np.diag(np.square(_SIGMAS)))
