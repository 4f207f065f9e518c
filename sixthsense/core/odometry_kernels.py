"""The increment of odometry in a control tick, with its covariance by the assumed noise, in kernels."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssumedConfig, Distribution, MotionNoise
from sixthsense.core.arcs import arc_jacobian, arc_length
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import Triple, between
from sixthsense.core.wheels import Wheels, true_motion

_FLOOR_PER_M, _FLOOR_PER_RAD = 0.25, 0.15  # distance and turn per floor, those between two keyframes


def variance_divisor(distribution: Distribution) -> float:
    """What the square of a noise's scale, sigma or half-width, is divided by to give its variance."""
    return 1.0 if distribution == "gaussian" else 3.0


class Slip(NamedTuple):
    """Variances that slip adds."""

    position_per_m: float
    """m^2 per metre, each axis"""
    position_per_rad: float
    """m^2 per radian, each axis"""
    heading_per_m: float
    """rad^2 per metre"""
    heading_per_rad: float
    """rad^2 per radian"""

    @staticmethod
    def of(noise: MotionNoise) -> Slip:
        """The variances of the noise of a drive."""
        return Slip(
            float(noise.slip_position_per_sqrt_m**2),
            float(noise.slip_position_per_sqrt_rad**2),
            float(noise.slip_heading_per_sqrt_m**2),
            float(noise.slip_heading_per_sqrt_rad**2),
        )


class OdometryNoise(NamedTuple):
    """The assumed noise of odometry."""

    speed: float
    """scale of the error of a distance, as a share of it"""
    turn_rate: float
    """scale of the error of a turn, as a share of it"""
    divisor: float
    """of the squares of both, as of `variance_divisor`"""
    slip: Slip
    floor_m2: float
    """variance of position between two keyframes beside that"""
    floor_rad2: float
    """variance of heading between two keyframes beside that"""
    wheels: Wheels

    @staticmethod
    @functools.cache
    def of(assumed: AssumedConfig) -> OdometryNoise:
        """That of a configuration."""
        noise = assumed.motion
        return OdometryNoise(
            float(noise.speed),
            float(noise.turn_rate),
            variance_divisor(noise.distribution),
            Slip.of(noise),
            float(assumed.floor_m**2),
            float(assumed.floor_rad**2),
            Wheels.assumed(assumed),
        )


@numba.njit(cache=True, error_model="numpy")
def slipped(slip: Slip, distance: float, turn: float) -> tuple[float, float]:
    """Variances of position (m^2, each axis) and heading (rad^2) that slip adds over a distance and a turn."""
    d, a = abs(distance), abs(turn)
    return slip.position_per_m * d + slip.position_per_rad * a, slip.heading_per_m * d + slip.heading_per_rad * a


@numba.njit(cache=True, error_model="numpy")
def motion_covariance(motion: Triple, noise: OdometryNoise) -> Array:
    """(3, 3) of a motion's error by the assumed noise.

    G Q G^T of the arc, with Q depending on its length and turn (the correct form of the report's eq. 8-9); slip and a
    floor beside it.
    """
    distance, turn = arc_length(motion[0], motion[1], motion[2]), motion[2]
    position, heading = slipped(noise.slip, distance, turn)
    share = max(abs(distance) / _FLOOR_PER_M, abs(turn) / _FLOOR_PER_RAD)
    position += noise.floor_m2 * share
    heading += noise.floor_rad2 * share
    by_distance, by_turn = noise.speed * distance, noise.turn_rate * turn
    by_distance, by_turn = by_distance * by_distance / noise.divisor, by_turn * by_turn / noise.divisor
    g, cov = arc_jacobian(distance, turn), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            cov[i, j] = g[i, 0] * by_distance * g[j, 0] + g[i, 1] * by_turn * g[j, 1]
    cov[0, 0] += position
    cov[1, 1] += position
    cov[2, 2] += heading
    return cov


@numba.njit(cache=True, error_model="numpy")
def increment(before: Triple, after: Triple, noise: OdometryNoise) -> tuple[Triple, Array]:
    """The motion between two different poses by the wheels, and (3, 3) of its error."""
    motion = true_motion(between(before, after), noise.wheels)
    return motion, motion_covariance(motion, noise)
