"""Systematic errors of the wheels: their parameters, the motion corrected for them, and its Jacobian by them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssumedConfig
from sixthsense.core.arcs import arc_length
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.se2 import Triple, wrapped

PARAMETERS = 3
"""number of the wheels' parameters"""


class Wheels(NamedTuple):
    """Systematic errors of a differential drive's odometry (Borenstein and Feng 1996)."""

    forward_scale_error: float = 0.0
    """true distance is (1 + this) times what the wheels report"""
    turn_scale_error: float = 0.0
    """true turn is (1 + this) times what the wheels report, plus the drift"""
    drift_rad_per_m: float = 0.0
    """turn that an unequal pair of wheels adds per true metre"""

    @classmethod
    def assumed(cls, config: AssumedConfig) -> Wheels:
        """The assumed values."""
        scale = float(config.wheel_scale_error)
        return cls(scale, scale, float(config.drift_rad_per_m))

    @classmethod
    def from_array(cls, values: Array) -> Wheels:
        """The parameters of three numbers, in the order of the fields."""
        return cls(*values.tolist())

    def array(self) -> Array:
        """(3,) in the order of the fields."""
        return np.array(self)


@dataclass(frozen=True, slots=True)
class WheelTerms:
    """How a motion by odometry depends on the wheels' parameters."""

    values: Wheels
    """the parameters that the motion was computed with"""
    jacobian: Array
    """(3, 3) of (x, y, theta) of the motion by the parameters, axes of the frame after; m, rad"""


_SCALE_SIGMA = 0.05
"""of the scale error that distance and turn have in common: of the wheels' radii, which wear and the load change"""
_TRACK_SIGMA = 0.02
"""of the scale error that turns have besides the common one: of the effective distance between the wheels"""
_DRIFT_SIGMA_RAD_PER_M = 0.03
"""a pair of wheels on a track of 0.4 m that differs by 1 % has 0.025"""


def wheel_prior(config: AssumedConfig) -> ParameterEstimate[Wheels]:
    """The prior of the parameters, about the assumed values."""
    cov = np.diag(np.square([0.0, _TRACK_SIGMA, _DRIFT_SIGMA_RAD_PER_M]))
    cov[:2, :2] += _SCALE_SIGMA**2
    return ParameterEstimate(Wheels.assumed(config), cov)


@numba.njit(cache=True, error_model="numpy")
def true_motion(motion: Triple, wheels: Wheels) -> Triple:
    """The true motion for the reported one: its arc is stretched and bent, and the chord turns by half of the bend."""
    if wheels == (0.0, 0.0, 0.0):
        return motion
    stretch = 1.0 + wheels.forward_scale_error
    distance = stretch * arc_length(motion[0], motion[1], motion[2])
    bend = wheels.turn_scale_error * motion[2] + wheels.drift_rad_per_m * distance
    c, s = math.cos(0.5 * bend), math.sin(0.5 * bend)
    x, y = stretch * (c * motion[0] - s * motion[1]), stretch * (s * motion[0] + c * motion[1])
    return x, y, wrapped(motion[2] + bend)


def corrected_with_terms(motion: Pose, wheels: Wheels) -> tuple[Pose, WheelTerms]:
    """The true motion for the reported one, and its dependence on the parameters."""
    found = Pose(*true_motion(motion.triple(), wheels))
    reported, stretch = arc_length(*motion.triple()), 1.0 + wheels.forward_scale_error
    jacobian = np.zeros((3, PARAMETERS))
    jacobian[2] = wheels.drift_rad_per_m * reported, motion.theta, stretch * reported
    jacobian[:2] = 0.5 * np.outer((-found.y, found.x), jacobian[2])
    jacobian[:2, 0] += found.position / stretch
    return found, WheelTerms(wheels, Pose(theta=-found.theta).adjoint() @ jacobian)
