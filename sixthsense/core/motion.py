"""Differential-drive motion: RK4 propagation, its noise, and odometry increments with their covariance."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from sixthsense.config import AssumedConfig, Distribution
from sixthsense.core.arcs import driven
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.odometry_kernels import OdometryNoise, increment, motion_covariance, variance_divisor
from sixthsense.core.se2 import between, move_covariance
from sixthsense.core.wheels import Wheels, WheelTerms, corrected_with_terms


def rk4(pose: Pose, speed: float, turn_rate: float, duration_s: float, step_s: float = math.inf) -> Pose:
    """Propagate a differential drive at constant speed (m/s) and turn rate (rad/s), in steps of at most `step_s`.

    Report eq. 6-7.
    """
    steps = max(1, math.ceil(duration_s / step_s - 1e-9))
    return Pose(*driven((pose.x, pose.y, pose.theta), float(speed), float(turn_rate), duration_s / steps, steps))


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
    by_pose = np.array(
        [
            [1.0, 0.0, -s * motion.x - c * motion.y],
            [0.0, 1.0, c * motion.x - s * motion.y],
            [0.0, 0.0, 1.0],
        ]
    )
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


def odometry(before: Pose, after: Pose, assumed: AssumedConfig) -> Odometry:
    """The increment between two odometry poses, with its covariance by the assumed noise.

    The multiplicative part is G Q G^T with Q depending on the command (the correct form of the report's eq. 8-9). Slip
    adds to it, and a small floor, without which the covariance has rank 2, or 1 when turning on the spot.
    """
    if before == after:
        return STANDSTILL  # the difference would have rounding errors that look like motion
    motion, cov = increment(
        (before.x, before.y, before.theta), (after.x, after.y, after.theta), OdometryNoise.of(assumed)
    )
    return Odometry(Pose(*motion), cov)


class WheelOdometry:
    """Odometry that depends on the wheels' parameters, whose values may change as they become known."""

    def __init__(self, assumed: AssumedConfig) -> None:
        self._assumed = assumed
        self.wheels = Wheels.assumed(assumed)
        """the present values"""
        self._reported = _Reported()

    def increment(self, before: Pose, after: Pose, duration_s: float) -> Odometry:
        """As `odometry`; `duration_s` is the time between the two poses."""
        reported, change = self._reported.moved(before, after, duration_s, self.wheels.latency_s)
        if reported == STANDSTILL.motion and not change.any():
            return STANDSTILL
        motion, terms = corrected_with_terms(reported, self.wheels, change)
        cov = (
            np.zeros((3, 3))
            if reported == STANDSTILL.motion
            else motion_covariance((motion.x, motion.y, motion.theta), OdometryNoise.of(self._assumed))
        )
        late = self._assumed.wheels.jitter_sigma_s * terms.jacobian[:, 3]
        return Odometry(motion, cov + np.outer(late, late), terms)


_LONGEST_DELAY_S = 2.0  # between what is reported and what the robot does


class _Reported:
    """The poses of the wheels in the last seconds: where the robot is by them, for any latency."""

    def __init__(self) -> None:
        self._poses: deque[tuple[float, Pose, Array]] = deque()
        """time, s, the pose then, and the velocity (3,) towards it, axes of the odometry's frame"""

    def moved(self, before: Pose, after: Pose, duration_s: float, latency_s: float) -> tuple[Pose, Array]:
        """The motion during the increment from `before` to `after`, and its derivative (3,) by the latency.

        Both are those of the poses that have that age at their stamps.
        """
        if not self._poses:
            self._poses.append((0.0, before, np.zeros(3)))
        start, first = self._at(latency_s)
        time_s = self._poses[-1][0] + duration_s
        way = np.array([after.x - before.x, after.y - before.y, wrap_angle(after.theta - before.theta)])
        self._poses.append((time_s, after, way / duration_s))
        while self._poses[1][0] < time_s - _LONGEST_DELAY_S:
            self._poses.popleft()
        end, last = self._at(latency_s)
        # The difference of places first: a turn on the spot has no rounding error then, which would look like a curve.
        motion = Pose() if start == end else Pose(*between(start.triple(), end.triple()))
        change = last - first
        change[:2] = change[:2] @ rotation(start.theta) + first[2] * np.array([motion.y, -motion.x])
        return motion, change

    def _at(self, latency_s: float) -> tuple[Pose, Array]:
        """The pose now, and the velocity (3,) there; poses that are not yet reported follow the last velocity."""
        time_s = self._poses[-1][0] + latency_s
        ends = reversed(self._poses)
        end_s, pose, velocity = next(ends)
        for start_s, start, earlier in ends:
            if time_s >= start_s and time_s != end_s:
                return Pose.from_array(start.array() + (time_s - start_s) * velocity), velocity
            if time_s >= start_s:
                break
            end_s, pose, velocity = start_s, start, earlier
        return pose, velocity
