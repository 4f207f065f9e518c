"""Systematic errors of the wheels: their parameters, the motion corrected for them, and its Jacobian by them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sixthsense.config import AssumedConfig
from sixthsense.core.arc import arc
from sixthsense.core.geometry import Array, Pose, rotation

PARAMETERS = 4
"""number of the wheels' parameters"""


@dataclass(frozen=True, slots=True)
class Wheels:
    """Systematic errors of a differential drive's odometry (Borenstein and Feng 1996), and its latency."""

    forward_scale_error: float = 0.0
    """true distance is (1 + this) times what the wheels report"""
    turn_scale_error: float = 0.0
    """true turn is (1 + this) times what the wheels report, plus the drift"""
    drift_rad_per_m: float = 0.0
    """turn that an unequal pair of wheels adds per true metre"""
    latency_s: float = 0.0
    """age of the reported pose at its stamp"""

    @classmethod
    def assumed(cls, config: AssumedConfig) -> Wheels:
        """The assumed values."""
        return cls(config.wheel_scale_error, config.wheel_scale_error, config.drift_rad_per_m)

    @classmethod
    def from_array(cls, values: Array) -> Wheels:
        """The parameters of four numbers, in the order of the fields."""
        return cls(*(float(value) for value in values))

    def array(self) -> Array:
        """(4,) in the order of the fields."""
        return np.array([self.forward_scale_error, self.turn_scale_error, self.drift_rad_per_m, self.latency_s])


@dataclass(frozen=True, slots=True)
class WheelTerms:
    """How a motion by odometry depends on the wheels' parameters."""

    values: Wheels
    """the parameters that the motion was computed with"""
    jacobian: Array
    """(3, 4) of (x, y, theta) of the motion by the parameters, axes of the frame before; m, rad"""


@dataclass(frozen=True, slots=True)
class WheelEstimate:
    """The wheels' parameters with their uncertainty: a prior, or an estimate."""

    values: Wheels
    cov: Array
    """(4, 4) of the parameters, in the order of the fields"""

    def with_sigmas(self) -> Array:
        """(2, 4) the parameters, and their sigmas."""
        return np.stack([self.values.array(), np.sqrt(np.maximum(np.diag(self.cov), 0.0))])


def wheel_prior(config: AssumedConfig) -> WheelEstimate:
    """The prior of the parameters: the assumed values, and the sigmas of `config.wheels`."""
    sigmas = config.wheels
    cov = np.diag(np.square([0.0, sigmas.track_sigma, sigmas.drift_sigma_rad_per_m, sigmas.latency_sigma_s]))
    cov[:2, :2] += sigmas.scale_sigma**2
    return WheelEstimate(Wheels.assumed(config), cov)


def corrected(motion: Pose, wheels: Wheels) -> Pose:
    """The true motion for the reported one."""
    if wheels.forward_scale_error == wheels.turn_scale_error == wheels.drift_rad_per_m == 0.0:
        return motion
    scale = 1.0 + wheels.forward_scale_error
    bend = wheels.turn_scale_error * motion.theta + wheels.drift_rad_per_m * scale * arc(motion)[0]
    # Bending an arc turns its chord by half as much as its end.
    chord = rotation(0.5 * bend) @ np.array([scale * motion.x, scale * motion.y])
    return Pose(chord[0], chord[1], motion.theta + bend)


def corrected_with_terms(motion: Pose, wheels: Wheels, velocity_change: Array) -> tuple[Pose, WheelTerms]:
    """The true motion for the reported one and its dependence on the parameters, the latency included.

    `velocity_change` (3,) is that of (x, y, theta) per second, from the increment before to this one. A pose that is
    old at its stamp lacks what the robot has moved since: over one increment, its velocity's change times the latency.
    """
    scale, length = 1.0 + wheels.forward_scale_error, arc(motion)[0]
    bend = wheels.turn_scale_error * motion.theta + wheels.drift_rad_per_m * scale * length
    c, s = math.cos(0.5 * bend), math.sin(0.5 * bend)
    x, y = c * motion.x - s * motion.y, s * motion.x + c * motion.y
    by_bend = np.array([wheels.drift_rad_per_m * length, motion.theta, scale * length])
    jacobian = np.zeros((3, PARAMETERS))
    jacobian[0, :3] = -0.5 * scale * y * by_bend
    jacobian[1, :3] = 0.5 * scale * x * by_bend
    jacobian[2, :3] = by_bend
    jacobian[0, 0] += x
    jacobian[1, 0] += y
    jacobian[:, 3] = velocity_change
    late_x, late_y, late_theta = (wheels.latency_s * velocity_change).tolist()
    pose = Pose(scale * x + late_x, scale * y + late_y, motion.theta + bend + late_theta)
    return pose, WheelTerms(wheels, jacobian)
