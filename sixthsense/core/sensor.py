"""Systematic errors of a sensor that names landmarks, as a camera does, and points corrected for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array, rotation
from sixthsense.core.parameters import ParameterEstimate

SENSOR_PARAMETERS = 3
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

    @classmethod
    def from_array(cls, values: Array) -> Sensor:
        """The parameters of three numbers, in the order of the fields."""
        return cls(*values.tolist())

    def array(self) -> Array:
        """(3,) in the order of the fields."""
        return np.array(self)

    def corrected(self, point: Array) -> tuple[Array, Array]:
        """A reported point (2,) corrected, and its Jacobian (2, 2) by the reported one.

        A camera measures a depth along its axis, which an error of its focal length leaves to the scale. It moves a
        point sideways. Kept at its range in place of its depth, a point at 0.5 rad would be off by half of its
        sideways error.
        """
        by_point = rotation(self.yaw_rad) * np.array([1.0, 1.0 + self.bearing_scale_error])
        return by_point @ point + np.array([self.forward_m, 0.0]), by_point

    def reported(self, point: Array) -> Array:
        """The reported point (2,) of one that is corrected."""
        seen = (point - np.array([self.forward_m, 0.0])) @ rotation(self.yaw_rad)
        return np.asarray(seen / np.array([1.0, 1.0 + self.bearing_scale_error]))

    def jacobian(self, point: Array) -> Array:
        """(2, 3) of a corrected point by the parameters, for the reported point (2,)."""
        turn = rotation(self.yaw_rad)
        x, y = (turn @ (point[0], (1.0 + self.bearing_scale_error) * point[1])).tolist()
        aside = point[1] * turn[:, 1]
        return np.array([[-y, 1.0, aside[0]], [x, 0.0, aside[1]]])


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
        """(2, 3) of the corrected point by the parameters."""
        return self.values.jacobian(self.z)


_SIGMAS = 0.03, 0.1, 0.03
"""rad of the yaw, m of the place, and the scale of bearings before any observation"""


def sensor_prior() -> ParameterEstimate[Sensor]:
    """The prior of the parameters: none is wrong, within 0.03 rad, 0.1 m and 3 %."""
    return ParameterEstimate(Sensor(), np.diag(np.square(_SIGMAS)))
