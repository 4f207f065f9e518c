"""Systematic errors of the wheels: their parameters, the motion corrected for them, and its Jacobian by them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssumedConfig
from sixthsense.core.arcs import arc, arc_length
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.se2 import Triple, wrapped

PARAMETERS = 5
"""number of the wheels' parameters"""


class Wheels(NamedTuple):
    """Systematic errors of a differential drive's odometry (Borenstein and Feng 1996), and its latency."""

    forward_scale_error: float = 0.0
    """true distance is (1 + this) times what the wheels report"""
    turn_scale_error: float = 0.0
    """true turn is (1 + this) times what the wheels report, plus the drift"""
    drift_rad_per_m: float = 0.0
    """turn that an unequal pair of wheels adds per true metre"""
    latency_s: float = 0.0
    """age of the reported pose at its stamp; negative: the robot does later what is reported, which is a command"""
    curve_loss_m_per_rad: float = 0.0
    """true distance is this much shorter per radian turned, on curves, than the wheels report"""

    @classmethod
    def assumed(cls, config: AssumedConfig) -> Wheels:
        """The assumed values."""
        scale = float(config.wheel_scale_error)
        return cls(scale, scale, float(config.drift_rad_per_m))

    @classmethod
    def from_array(cls, values: Array) -> Wheels:
        """The parameters of five numbers, in the order of the fields."""
        return cls(*(float(value) for value in values))

    def array(self) -> Array:
        """(5,) in the order of the fields."""
        return np.array(self)


@dataclass(frozen=True, slots=True)
class WheelTerms:
    """How a motion by odometry depends on the wheels' parameters."""

    values: Wheels
    """the parameters that the motion was computed with"""
    jacobian: Array
    """(3, 5) of (x, y, theta) of the motion by the parameters, axes of the frame after; m, rad"""


_SCALE_SIGMA = 0.05
"""of the scale error that distance and turn have in common: of the wheels' radii, which wear and the load change"""
_TRACK_SIGMA = 0.02
"""of the scale error that turns have besides the common one: of the effective distance between the wheels"""
_DRIFT_SIGMA_RAD_PER_M = 0.03
"""a pair of wheels on a track of 0.4 m that differs by 1 % has 0.025"""


def wheel_prior(config: AssumedConfig) -> ParameterEstimate[Wheels]:
    """The prior of the parameters: the assumed values, and the sigmas of `config.wheels`."""
    sigmas = config.wheels
    cov = np.diag(
        np.square([
            *(0.0, _TRACK_SIGMA, _DRIFT_SIGMA_RAD_PER_M, sigmas.latency_sigma_s),
            sigmas.curve_loss_sigma_m_per_rad,
        ])
    )  # fmt: skip
    cov[:2, :2] += _SCALE_SIGMA**2
    return ParameterEstimate(Wheels.assumed(config), cov)


@numba.njit(cache=True, error_model="numpy")
def _bent(reported: float, turn: float, wheels: Wheels) -> tuple[float, float, bool]:
    """What corrects an arc of a reported length (m) and turn: added turn (rad), factor of the length; is it a drive."""
    scale, lost = 1.0 + wheels.forward_scale_error, wheels.curve_loss_m_per_rad * abs(turn)
    is_driving = scale * abs(reported) >= max(lost, 0.0)  # it does not turn on the spot
    stretch = 0.0
    if is_driving:
        stretch = scale - (lost / abs(reported) if reported != 0.0 else 0.0)
    return wheels.turn_scale_error * turn + wheels.drift_rad_per_m * stretch * reported, stretch, is_driving


@numba.njit(cache=True, error_model="numpy")
def _turned_chord(x: float, y: float, bend: float) -> tuple[float, float]:
    """The end of an arc that is bent by an angle: its chord turns by half as much as its end."""
    c, s = math.cos(0.5 * bend), math.sin(0.5 * bend)
    return c * x - s * y, s * x + c * y


@numba.njit(cache=True, error_model="numpy")
def true_motion(motion: Triple, wheels: Wheels) -> Triple:
    """The true motion for the reported one; the latency is no part of it."""
    if wheels == (0.0, 0.0, 0.0, 0.0, 0.0):
        return motion
    bend, stretch, _ = _bent(arc_length(motion[0], motion[1], motion[2]), motion[2], wheels)
    x, y = _turned_chord(motion[0], motion[1], bend)
    return stretch * x, stretch * y, wrapped(motion[2] + bend)


def corrected_with_terms(motion: Pose, wheels: Wheels, velocity_change: Array) -> tuple[Pose, WheelTerms]:
    """The true motion for the reported one and its dependence on the parameters, on the latency by its change.

    `velocity_change` (3,) is that of (x, y, theta) per second, from the increment before to this one. A pose that is
    old at its stamp lacks what the robot has moved since: over one increment, its velocity's change times the change of
    the latency. The motion itself is that for the present latency.
    """
    reported = arc(motion)[0]
    bend, stretch, is_driving = _bent(reported, motion.theta, wheels)
    x, y = _turned_chord(motion.x, motion.y, bend)
    by_loss = -abs(motion.theta) / abs(reported) if is_driving and reported else 0.0
    jacobian = np.zeros((3, PARAMETERS))
    for k, by_parameter in ((0, float(is_driving)), (4, by_loss)):  # of the stretch
        jacobian[:2, k] = by_parameter * x, by_parameter * y
        jacobian[2, k] = wheels.drift_rad_per_m * reported * by_parameter
    jacobian[2, 1:3] = motion.theta, stretch * reported
    jacobian[:2] += 0.5 * stretch * np.outer((-y, x), jacobian[2])
    jacobian[:, 3] = velocity_change
    found = Pose(stretch * x, stretch * y, motion.theta + bend)
    return found, WheelTerms(wheels, Pose(theta=-found.theta).adjoint() @ jacobian)
