"""Differential-drive motion: RK4 propagation, its noise, and odometry increments with their covariance."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssumedConfig, Distribution, MotionNoise
from sixthsense.core.arcs import arc_jacobian, arc_length, driven
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import Triple, between, move_covariance
from sixthsense.core.wheels import Wheels, WheelTerms, corrected_with_terms, true_motion

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
        of_position = noise.slip_position_per_sqrt_m, noise.slip_position_per_sqrt_rad
        of_heading = noise.slip_heading_per_sqrt_m, noise.slip_heading_per_sqrt_rad
        return Slip(*(float(sigma**2) for sigma in (*of_position, *of_heading)))


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


def rk4(pose: Pose, speed: float, turn_rate: float, duration_s: float, step_s: float = math.inf) -> Pose:
    """Propagate a differential drive at constant speed (m/s) and turn rate (rad/s), in steps of at most `step_s`.

    Report eq. 6-7.
    """
    steps = max(1, math.ceil(duration_s / step_s - 1e-9))
    return Pose(*driven(pose.triple(), float(speed), float(turn_rate), duration_s / steps, steps))


def draw(rng: np.random.Generator, distribution: Distribution, scale: float, size: int | None = None) -> Array:
    """Zero-mean noise: `scale` is sigma if gaussian, the half-width if uniform; either takes one draw per value."""
    if distribution == "gaussian":
        return np.asarray(scale * rng.standard_normal(size))
    return np.asarray(scale * (2.0 * rng.random(size) - 1.0))


def variance(distribution: Distribution, scale: float) -> float:
    """Variance of what `draw` returns."""
    return scale * scale / variance_divisor(distribution)


def compose_jacobians(heading: float, motion: Pose) -> tuple[Array, Array]:
    """Jacobians of `pose @ motion` in (x, y, theta): (3, 3) by the pose, whose heading is given, and by the motion.

    The motion's error is in the axes of the frame in which it ends.
    """
    c, s = math.cos(heading), math.sin(heading)
    by_pose = np.eye(3)
    by_pose[:2, 2] = -s * motion.x - c * motion.y, c * motion.x - s * motion.y
    return by_pose, Pose(theta=heading + motion.theta).adjoint()


def propagated(pose: Pose, cov: Array, motion: Odometry) -> Array:
    """(3, 3) of `pose @ motion.motion` in world axes, by that of `pose`; their errors are independent."""
    by_pose, by_motion = compose_jacobians(pose.theta, motion.motion)
    return np.asarray(by_pose @ cov @ by_pose.T + by_motion @ motion.cov @ by_motion.T)


_CARRIED_M = 0.25  # sigma of the position of one motion, beyond which no wheel has measured it


@dataclass(frozen=True, slots=True)
class Odometry:
    """An increment of motion in the robot's frame, with its covariance."""

    motion: Pose
    """`T_before_after`"""
    cov: Array
    """(3, 3) of the error of (x, y, theta) of `motion`, axes of the frame after, as GTSAM has it; m, rad"""
    wheels: WheelTerms | None = None
    """its dependence on the wheels' parameters, if these are estimated; their uncertainty is not in `cov`"""

    def is_standstill(self) -> bool:
        """Whether the motion is zero without uncertainty, for any parameters of the wheels."""
        return self.motion == STANDSTILL.motion and self.wheels is None and not np.any(self.cov)

    def is_carried(self) -> bool:
        """Whether no wheel has measured the motion: its position is known to some decimetres only."""
        return bool(max(self.cov[0, 0], self.cov[1, 1]) > _CARRIED_M**2)

    def then(self, later: Odometry) -> Odometry:
        """Compose two increments with independent errors: `self` first, then `later`, whose arrays may change after."""
        if later is STANDSTILL:
            return self
        if self is STANDSTILL:
            return Odometry(later.motion, np.array(later.cov), later.wheels)
        first = self if later.wheels is None else self.with_wheels(later.wheels.values)
        back = later.motion.inverse()
        cov = move_covariance(back.triple(), first.cov) + later.cov
        terms = later.wheels
        if first.wheels is not None:
            jacobian = back.adjoint() @ first.wheels.jacobian
            terms = WheelTerms(first.wheels.values, jacobian if terms is None else jacobian + terms.jacobian)
        return Odometry(first.motion @ later.motion, cov, terms)

    def inverse(self) -> Odometry:
        """The motion back, with the same error, for the present parameters of the wheels."""
        return Odometry(self.motion.inverse(), move_covariance(self.motion.triple(), self.cov))

    def with_wheels(self, values: Wheels) -> Odometry:
        """The same increment for other parameters of the wheels, to first order."""
        if self.wheels is None or self.wheels.values == values:
            return self
        change = self.wheels.jacobian @ (values.array() - self.wheels.values.array())
        motion = self.motion @ Pose.from_array(change)
        return Odometry(motion, self.cov, WheelTerms(values, self.wheels.jacobian))


STANDSTILL = Odometry(Pose(), np.zeros((3, 3)))
STANDSTILL.cov.flags.writeable = False


def odometry(before: Pose, after: Pose, assumed: AssumedConfig, wheels: Wheels | None = None) -> Odometry:
    """The increment between two odometry poses, with its covariance by the assumed noise.

    For `wheels`, which are estimated, it has its dependence on them.

    The multiplicative part is G Q G^T with Q depending on the command (the correct form of the report's eq. 8-9). Slip
    adds to it, and a small floor, without which the covariance has rank 2, or 1 when turning on the spot.
    """
    return odometry_of_noise(before, after, OdometryNoise.of(assumed), wheels)


def odometry_of_noise(before: Pose, after: Pose, noise: OdometryNoise, wheels: Wheels | None) -> Odometry:
    """The same as `odometry`, by the noise that was computed once: for each control tick."""
    if before == after:
        return STANDSTILL  # the difference would have rounding errors that look like motion
    if wheels is None:
        motion, cov = increment(before.triple(), after.triple(), noise)
        return Odometry(Pose(*motion), cov)
    corrected, terms = corrected_with_terms(Pose(*between(before.triple(), after.triple())), wheels)
    return Odometry(corrected, motion_covariance(corrected.triple(), noise), terms)
