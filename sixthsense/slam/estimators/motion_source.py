"""Where the robot's motion comes from: its wheels, wheels that are calibrated on line, or its last velocity.

Wheels are wrong by more than the noise of their increments states: by a few percent, always to the same side.

Without odometry the robot's velocity is a first-order Gauss-Markov (Ornstein-Uhlenbeck) process about standstill: of
stationary sigma V and correlation time tau, so that it is kept over a scan and forgotten over a gap. Singer 1970,
"Estimating optimal tracking filter performance for manned maneuvering targets". Scan matching measures it from one scan
to the next.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from sixthsense.config import AssumedConfig, Config, WheelsConfig
from sixthsense.config.errors import InputError
from sixthsense.config.parts import NEEDS_FILTER
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.motion import Odometry, OdometryNoise, odometry_of_noise
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.source import Tick
from sixthsense.core.wheels import Wheels, wheel_prior
from sixthsense.slam.estimators import Estimator, Filter

_USUAL = WheelsConfig()


class ByWheels:
    """Wheels have measured the motion, whose parameters the estimator may estimate."""

    is_guess = False
    """whether nothing has measured the motion: the scan alone tells it; a doubtful alignment is searched again"""

    def __init__(self, assumed: AssumedConfig, estimate: ParameterEstimate[Wheels] | None = None) -> None:
        """By the assumed noise, and by the newest `estimate` of the parameters if they are estimated."""
        self._errors, self._noise, self.estimate = assumed.wheels, OdometryNoise.of(assumed), estimate
        self._is_stated = False
        """whether the log states the covariance of the newest increment"""

    def increment(self, before: Pose, tick: Tick, duration_s: float) -> Odometry:
        """The motion since the last tick, with the covariance that the log states or that of the assumed noise.

        `before` is `T_odom_robot` at the last tick.
        """
        self._is_stated = tick.increment_cov is not None
        if tick.increment_cov is not None:
            return Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
        wheels = None if self.estimate is None else self.estimate.values
        return odometry_of_noise(before, tick.odometry, self._noise, wheels)

    def for_estimator(self, since: Odometry) -> Odometry:
        """The motion since the last keyframe, with the errors of wheels unless the log states its covariance.

        It is that which is reported between keyframes, and which the estimator is given at the next keyframe.
        """
        return since if self._is_stated else with_wheel_errors(since, self._errors)

    for_tracking = for_estimator
    """the same, for a scan to be aligned from"""


def with_wheel_errors(odometry: Odometry, errors: WheelsConfig = _USUAL) -> Odometry:
    """Odometry with the assumed errors of wheels in its covariance."""
    motion = odometry.motion
    distance, turn = math.hypot(motion.x, motion.y), abs(motion.theta)
    position = (errors.position_m + errors.position_per_m * distance) ** 2
    heading = (errors.heading_rad + errors.heading_per_rad * turn + errors.heading_per_m * distance) ** 2
    cov = odometry.cov.copy()
    cov[0, 0] += position
    cov[1, 1] += position
    cov[2, 2] += heading
    return Odometry(motion, cov, odometry.wheels)


_SIGMAS = np.array([1.0, 1.0, 1.0])  # m/s, m/s, rad/s: somebody who walks, and looks around
_TAUS_S = np.array([40.0, 40.0, 1.0])  # correlation times: one goes on for a while, and turns for a moment
_STAMPS, _APART = 64, 16  # stamps that tell the period, and scans within which a delay is made up for


def scan_clock() -> Callable[[float], float]:
    """What tells the time since the scan before, seconds, of that which the stamps state.

    A laser's period is steadier than its stamps, which are late where a computer was busy. A stamp that is late is made
    up for by the next ones; one after a gap is not. A gap is what is later than any delay that was made up for so far.
    """
    stamps_s: deque[float] = deque([0.0], maxlen=_STAMPS)  # of the last scans, since the first one
    longest_s = 0.0  # the longest delay that was made up for

    def period(stated_s: float) -> float:
        nonlocal longest_s
        stamps_s.append(stamps_s[-1] + stated_s)
        stamps = np.array(stamps_s)
        apart = min(_APART, len(stamps) - 1)
        # The median bears a gap, and delays that are made up for.
        usual_s = float(np.median(stamps[apart:] - stamps[:-apart])) / apart
        before = stamps[-apart - 1 : -1]
        late_s = stamps[-1] - (before + usual_s * np.arange(apart, 0, -1))
        is_gap = apart == _APART and late_s.max() > max(longest_s, usual_s)
        longest_s = max(longest_s, -float(late_s.min()))
        return max(stated_s, usual_s) if is_gap else usual_s

    return period


class LastVelocity:
    """Predicts the motion between scans by a Kalman filter, which is told what scan matching has found.

    Its state is the motion since the last keyframe and the robot's velocity, in its own axes.
    """

    is_guess = True

    def __init__(self) -> None:
        self._period = scan_clock()
        self._velocity = np.zeros(3)
        """(3,) m/s and rad/s"""
        self._cov = np.diag(_SIGMAS**2)
        """(3, 3) of the velocity"""
        self._cross = np.zeros((3, 3))
        """(3, 3) of the motion since the last keyframe with the velocity"""
        self._since_key_s = 0.0
        """time since the last keyframe"""
        self._stated_s = self._predicted_s = 0.0
        """time since the last scan by the stamps, and what of it is predicted"""

    def increment(self, before: Pose, tick: Tick, duration_s: float) -> Odometry:
        """The motion since the last tick, `duration_s` ago, that the velocity predicts; odometry is left out."""
        is_scan = tick.scan is not None
        self._stated_s += duration_s
        elapsed_s = self._period(self._stated_s) if is_scan else self._stated_s
        step_s, self._predicted_s = max(elapsed_s - self._predicted_s, 0.0), max(elapsed_s, self._predicted_s)
        ratio = step_s / _TAUS_S
        kept, way_s = np.exp(-ratio), -_TAUS_S * np.expm1(-ratio)
        x, y, turn = (way_s * self._velocity).tolist()
        chord = rotation(0.5 * turn) @ np.array([x, y])
        motion = Pose(chord[0], chord[1], turn)
        by_since, by_motion = motion.inverse().adjoint(), Pose(theta=-turn).adjoint()
        # Moments of the integral of the process and of the process, Singer 1970.
        of_way = _SIGMAS**2 * _TAUS_S**2 * (2 * ratio - 3 + 4 * kept - kept**2)
        of_both, of_velocity = _SIGMAS**2 * _TAUS_S * (1.0 - kept) ** 2, _SIGMAS**2 * (1.0 - kept**2)
        by_velocity = by_motion * way_s
        self._since_key_s += step_s
        mixed = by_since @ self._cross @ by_velocity.T
        added = mixed + mixed.T + by_velocity @ self._cov @ by_velocity.T
        added += by_motion @ np.diag(np.maximum(of_way, 0.0)) @ by_motion.T
        values, axes = np.linalg.eigh(added)
        self._cross = (by_since @ self._cross + by_velocity @ self._cov) * kept + by_motion * of_both
        self._cov = self._cov * np.outer(kept, kept) + np.diag(of_velocity)
        self._velocity = kept * self._velocity
        return Odometry(motion, (axes * np.maximum(values, 0.0)) @ axes.T)

    def aligned(self, since: Odometry, found: Odometry | None) -> Odometry:
        """The motion since the last keyframe as found by scan matching; without that the guess, and no velocity."""
        if found is None:
            self.lost()
            return since
        # From the prior that the scan was aligned with: without its allowance the way of a millisecond is known to less
        # than any scan, and what scans are off by would be a velocity of metres a second.
        guessed = self.for_tracking(since)
        gain = np.linalg.solve(guessed.cov, self._cross)  # (3, 3) of the smoother: velocity by motion
        off = (guessed.motion.inverse() @ found.motion).array()
        self._velocity = self._velocity + gain.T @ off
        self._cov = self._cov - gain.T @ (guessed.cov - found.cov) @ gain
        self._cov = 0.5 * (self._cov + self._cov.T)
        self._cross = found.cov @ gain
        self._stated_s = self._predicted_s = 0.0
        return found

    def for_tracking(self, since: Odometry) -> Odometry:
        """The guess, with an allowance for a robot that has just begun to move."""
        return with_wheel_errors(since)

    def for_estimator(self, since: Odometry) -> Odometry:
        """The motion since the last keyframe, with the share of its error that goes on from keyframe to keyframe.

        A velocity that was last told a time t ago is wrong by a random walk since then, and by the same in neighbouring
        motions, each over a time T: with the rate q of its variance the whole way has the variance q t^3 / 3. Motions
        that count as independent add up to that if each counts with t / T times its own, T^2 q t. What is left of the
        variance V^2 at standstill tells t, of which the correlation time on either side counts.
        """
        if not self._since_key_s:
            return since
        told = np.maximum(1.0 - np.diag(self._cov) / _SIGMAS**2, math.exp(-4))
        age_s = np.maximum(-0.5 * _TAUS_S * np.log(told), 0.0)
        factors = np.sqrt(1.0 + age_s / self._since_key_s)
        return Odometry(since.motion, since.cov * np.outer(factors, factors))

    def begin_anew(self) -> None:
        """Begin the motion anew, at a keyframe."""
        self._cross, self._since_key_s = np.zeros((3, 3)), 0.0

    def lost(self) -> None:
        """Forget the velocity, since scan matching has found no motion."""
        self._velocity, self._cov = np.zeros(3), np.diag(_SIGMAS**2)
        self._stated_s = self._predicted_s = 0.0
        self.begin_anew()


class Motion:
    """The motion between ticks by the source that is present: wheels, and the last velocity where nothing measures it.

    A log says of each tick whether wheels have measured the motion to it.
    """

    def __init__(self, wheels: ByWheels | None) -> None:
        """Begin with `wheels`, or without any."""
        self._wheels, self._velocity = wheels, LastVelocity()
        self.present: ByWheels | LastVelocity = wheels or self._velocity
        """says what the motion since the last keyframe is worth"""

    def increment(self, before: Pose, tick: Tick, duration_s: float) -> Odometry:
        """The motion since the last tick, `duration_s` ago; by the last velocity where wheels have not measured it.

        `before` is `T_odom_robot` then.
        """
        if self._wheels is not None and not tick.is_unmeasured:
            self.present = self._wheels
        elif self.present is not self._velocity:
            self._velocity.lost()  # it begins as unknown
            self.present = self._velocity
        return self.present.increment(before, tick, duration_s)

    def at_keyframe(self, wheels: ParameterEstimate[Wheels] | None) -> None:
        """Begin anew at a keyframe, with the wheels' parameters if they are estimated."""
        if wheels is not None and self._wheels is not None:
            self._wheels.estimate = wheels
        if self.present is self._velocity:
            self._velocity.begin_anew()


def make_motion(config: Config, estimator: Estimator) -> Motion:
    """The configured sources of motion; InputError for an estimator that cannot estimate the wheels, if it is to."""
    if config.no_odometry:
        return Motion(None)
    if not config.calibrate_wheels:
        return Motion(ByWheels(config.assumed))
    if not isinstance(estimator, Filter):
        raise InputError("calibrate_wheels", f"found true with {config.estimator}", NEEDS_FILTER)
    prior = wheel_prior(config.assumed)
    estimator.calibrate(prior)
    return Motion(ByWheels(config.assumed, prior))
