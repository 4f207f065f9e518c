"""Differential-drive motion: RK4 propagation, its noise, and odometry increments with their covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sixthsense.config import AssumedConfig, Distribution, MotionNoise
from sixthsense.core.geometry import Array, Pose, rotation

_FLOOR_PER_M, _FLOOR_PER_RAD = 0.25, 0.15  # distance and turn per floor, those between two key scans


def rk4(pose: Pose, speed: float, turn_rate: float, duration_s: float, step_s: float = math.inf) -> Pose:
    """Propagate a differential drive at constant speed (m/s) and turn rate (rad/s), in steps of at most `step_s`.

    Report eq. 6-7. The heading of a differential drive depends on time alone, so k2 equals k3.
    """
    steps = max(1, math.ceil(duration_s / step_s - 1e-9))
    h = duration_s / steps
    x, y, theta = pose.x, pose.y, pose.theta
    for _ in range(steps):
        middle, end = theta + 0.5 * h * turn_rate, theta + h * turn_rate
        x += h / 6.0 * speed * (math.cos(theta) + 4.0 * math.cos(middle) + math.cos(end))
        y += h / 6.0 * speed * (math.sin(theta) + 4.0 * math.sin(middle) + math.sin(end))
        theta = end
    return Pose(x, y, theta)


def draw(rng: np.random.Generator, distribution: Distribution, scale: float, size: int | None = None) -> Array:
    """Zero-mean noise: `scale` is sigma if gaussian, the half-width if uniform; either takes one draw per value."""
    if distribution == "gaussian":
        return np.asarray(scale * rng.standard_normal(size))
    return np.asarray(scale * (2.0 * rng.random(size) - 1.0))


def variance(distribution: Distribution, scale: float) -> float:
    """Variance of what `draw` returns."""
    return scale * scale if distribution == "gaussian" else scale * scale / 3.0


def slip_variances(noise: MotionNoise, distance: float, turn: float) -> tuple[float, float]:
    """Variances of position (m^2, each axis) and heading (rad^2) that slip adds over a distance and a turn."""
    d, a = abs(distance), abs(turn)
    position = noise.slip_position_per_sqrt_m**2 * d + noise.slip_position_per_sqrt_rad**2 * a
    heading = noise.slip_heading_per_sqrt_m**2 * d + noise.slip_heading_per_sqrt_rad**2 * a
    return position, heading


def compose_jacobians(heading: float, motion: Pose) -> tuple[Array, Array]:
    """Jacobians of `pose @ motion` in (x, y, theta): (3, 3) by the pose, whose heading is given, and by the motion."""
    c, s = math.cos(heading), math.sin(heading)
    by_pose = np.array(
        [
            [1.0, 0.0, -s * motion.x - c * motion.y],
            [0.0, 1.0, c * motion.x - s * motion.y],
            [0.0, 0.0, 1.0],
        ]
    )
    return by_pose, Pose(theta=heading).adjoint()


@dataclass(frozen=True, slots=True)
class Odometry:
    """An increment of motion in the robot's frame, with its covariance."""

    motion: Pose
    """`T_before_after`"""
    cov: Array
    """(3, 3) of the error of (x, y, theta) of `motion`, axes of the frame before; m, rad"""

    def is_standstill(self) -> bool:
        """Whether the motion is zero without uncertainty."""
        return self.motion == STANDSTILL.motion and not np.any(self.cov)

    def cov_after(self) -> Array:
        """(3, 3) of the same error in the axes of the frame after, the convention of factor graphs."""
        turn = Pose(theta=-self.motion.theta).adjoint()
        cov = turn @ self.cov @ turn.T
        return np.asarray(0.5 * (cov + cov.T))

    def then(self, later: Odometry) -> Odometry:
        """Compose two increments with independent errors: `self` first, then `later`."""
        by_self, by_later = compose_jacobians(self.motion.theta, later.motion)
        cov = by_self @ self.cov @ by_self.T + by_later @ later.cov @ by_later.T
        return Odometry(self.motion @ later.motion, cov)


STANDSTILL = Odometry(Pose(), np.zeros((3, 3)))
STANDSTILL.cov.flags.writeable = False


def arc(motion: Pose) -> tuple[float, float]:
    """Length (m, signed) and turn (rad) of the circular arc with the end pose `motion`, as of a differential drive."""
    half = 0.5 * motion.theta
    chord = motion.x * math.cos(half) + motion.y * math.sin(half)
    return chord / _sinc(half), motion.theta


def arc_jacobian(distance: float, turn: float) -> Array:
    """Jacobian (3, 2) of an arc's end (x, y, theta), frame of its start, by its length (m, signed) and turn (rad)."""
    half = 0.5 * turn
    c, s, sinc = math.cos(half), math.sin(half), _sinc(half)
    slope = -half / 3.0 if abs(half) < 1e-4 else (math.cos(half) - sinc) / half  # d sinc / d half
    return np.array(
        [
            [sinc * c, 0.5 * distance * (slope * c - sinc * s)],
            [sinc * s, 0.5 * distance * (slope * s + sinc * c)],
            [0.0, 1.0],
        ]
    )


def odometry(before: Pose, after: Pose, assumed: AssumedConfig) -> Odometry:
    """The increment between two odometry poses, with its covariance by the assumed noise.

    The multiplicative part is G Q G^T with Q depending on the command (the correct form of the report's eq. 8-9). Slip
    adds to it, and a small floor, without which the covariance has rank 2, or 1 when turning on the spot.
    """
    if before == after:
        return STANDSTILL  # the difference would have rounding errors that look like motion
    motion = _corrected(before.inverse() @ after, assumed)
    distance, turn = arc(motion)
    noise = assumed.motion
    g = arc_jacobian(distance, turn)
    q = np.array(
        [variance(noise.distribution, noise.speed * distance), variance(noise.distribution, noise.turn_rate * turn)]
    )
    position, heading = slip_variances(noise, distance, turn)
    share = max(abs(distance) / _FLOOR_PER_M, abs(turn) / _FLOOR_PER_RAD)
    position += assumed.floor_m**2 * share
    heading += assumed.floor_rad**2 * share
    return Odometry(motion, (g * q) @ g.T + np.diag([position, position, heading]))


def _corrected(motion: Pose, assumed: AssumedConfig) -> Pose:
    """The increment corrected for the wheels' assumed systematic errors (Borenstein and Feng 1996)."""
    if assumed.wheel_scale_error == 0.0 and assumed.drift_rad_per_m == 0.0:
        return motion
    scale = 1.0 + assumed.wheel_scale_error
    bend = assumed.wheel_scale_error * motion.theta + assumed.drift_rad_per_m * scale * arc(motion)[0]
    # Bending an arc turns its chord by half as much as its end.
    chord = rotation(0.5 * bend) @ np.array([scale * motion.x, scale * motion.y])
    return Pose(chord[0], chord[1], motion.theta + bend)


def _sinc(angle: float) -> float:
    return 1.0 - angle * angle / 6.0 if abs(angle) < 1e-4 else math.sin(angle) / angle
