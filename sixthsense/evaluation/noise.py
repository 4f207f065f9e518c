"""Fits of the robot's noise to samples of driving whose truth is known (report section 4.1)."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from sixthsense.config import AssumedConfig, Config, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, predict_points
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, odometry
from sixthsense.evaluation.metrics import nees_world
from sixthsense.slam.features import extract

FEWEST_SAMPLES = 20
SIGNIFICANT = 3.0  # sigmas

_GATE_M = 0.25  # a sighting farther than this from every true landmark is of none
_FINEST_M = 1e-3  # no laser is believed to be better
_HALVINGS = 10
_UNIT_SQ = 1e-12  # (1 um)^2, (1 urad)^2: nobody measures better, and no covariance is singular
_OUTLIER = float(chi2.ppf(0.999, 2))  # what association would not match

# Sizes of the noise from which the search starts where none is assumed.
_MOTION = {
    "speed": 0.1,
    "turn_rate": 0.1,
    "slip_position_per_sqrt_m": 5e-3,
    "slip_position_per_sqrt_rad": 2e-3,
    "slip_heading_per_sqrt_m": 0.01,
    "slip_heading_per_sqrt_rad": 0.01,
}
_SYSTEMATIC = ("wheel_scale_error", "drift_rad_per_m")


class CalibrationError(InputError):
    """One line for a calibration that cannot be made."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Half a second of driving and the scan at its end."""

    odometry: tuple[Pose, ...]
    """at every control tick, both ends included"""
    motion: Pose
    """the true `T_before_after`"""
    truth: Pose
    """`T_world_robot` at its end"""
    scan: Scan
    """taken there"""


@dataclass(frozen=True, slots=True)
class LandmarkErrors:
    """Errors of sightings against the true landmarks (report eq. 2)."""

    kinds: Array
    """(K,) Kind of each"""
    errors: Array
    """(K, 2) sighted minus true position, robot's frame, metres"""
    covs: Array
    """(K, 2, 2) that each sighting claims"""
    false: int
    """sightings near no true landmark, left out of the above"""

    @property
    def nees(self) -> Array:
        """(K,) normalised errors squared, 2 on average when the claims are right."""
        return np.asarray(
            np.einsum("ki,ki->k", self.errors, np.linalg.solve(self.covs, self.errors[..., None])[..., 0])
        )

    @property
    def mean_nees(self) -> float:
        """Mean NEES of the sightings that association would match; infinite where it would match none."""
        nees = self.nees
        inside = nees[nees <= _OUTLIER]
        return float(inside.mean()) if len(inside) else math.inf

    @property
    def outside(self) -> int:
        """Sightings that association would not match."""
        return int(np.sum(self.nees > _OUTLIER))

    def of(self, kind: Kind) -> Array:
        """(N, 2) errors of one kind."""
        return np.asarray(self.errors[self.kinds == kind])


@dataclass(frozen=True, slots=True)
class PropagationErrors:
    """Errors of odometry increments against the true motion (report eq. 1)."""

    errors: Array
    """(N, 3) true minus assumed motion, frame before, metres and radians"""
    covs: Array
    """(N, 3, 3) that odometry claims"""

    @property
    def nees(self) -> Array:
        """(N,) normalised errors squared, 3 on average when the claims are right."""
        return nees_world(self.errors, self.covs)

    @property
    def normalised(self) -> Array:
        """(N, 3) errors in units of their claimed sigmas, decorrelated."""
        return np.asarray(np.linalg.solve(np.linalg.cholesky(self.covs), self.errors[..., None])[..., 0])


def _fold(track: Sequence[Pose], assumed: AssumedConfig) -> Odometry:
    """A sample's increments as one, as a filter that predicts at every tick would have them."""
    total = STANDSTILL
    for before, after in itertools.pairwise(track):
        total = total.then(odometry(before, after, assumed))
    return total


def _folded(samples: Sequence[Sample], assumed: AssumedConfig) -> tuple[Array, Array]:
    """(N, 3) motions and (N, 3, 3) covariances."""
    folded = [_fold(sample.odometry, assumed) for sample in samples]
    return np.array([one.motion.array() for one in folded]), np.array([one.cov for one in folded]) + _UNIT_SQ * np.eye(
        3
    )


def propagation_errors(samples: Sequence[Sample], assumed: AssumedConfig) -> PropagationErrors:
    """Compare what odometry makes of each sample with the true motion (report eq. 1)."""
    motions, covs = _folded(samples, assumed)
    return PropagationErrors(_difference(np.array([s.motion.array() for s in samples]), motions), covs)


def _difference(a: Array, b: Array) -> Array:
    gap = a - b
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def fit_motion(
    samples: Sequence[Sample], assumed: AssumedConfig
) -> tuple[AssumedConfig, dict[str, tuple[float, float]]]:
    """`assumed` with the motion's noise of greatest likelihood, and the systematic errors' estimates and sigmas.

    The covariance is linear in the squares of the noise's parameters, the motion nearly so in the systematic errors:
    generalised least squares for the latter and a search over the former take turns. The mean NEES comes out near 3.
    A systematic error within three of its own sigmas stays zero, and counts as noise. What the samples cannot tell
    apart, such as slip and turn noise, stays near what was assumed: a prior holds each parameter to a factor of e.
    """
    straight = dataclasses.replace(assumed, wheel_scale_error=0.0, drift_rad_per_m=0.0)
    silent = merge(straight, {"motion": dict.fromkeys(_MOTION, 0.0)})
    motions, floor = _folded(samples, silent)
    sizes = {name: getattr(assumed.motion, name) or size for name, size in _MOTION.items()}
    parts = [_folded(samples, merge(silent, {"motion": {name: s}}))[1] - floor for name, s in sizes.items()]
    basis = np.array(parts)  # (6, N, 3, 3)
    step = 1e-3
    nudged = [_folded(samples, merge(silent, {name: step}))[0] for name in _SYSTEMATIC]
    slope = np.stack([_difference(n, motions) / step for n in nudged], axis=2)  # (N, 3, 2)
    errors = _difference(np.array([s.motion.array() for s in samples]), motions)

    kept = [0, 1]
    scales = np.zeros(len(sizes))  # logarithms
    theta = np.zeros(2)
    for turn in range(4):
        scales = _likeliest(errors - slope @ theta, floor, basis, scales)
        weight = np.linalg.inv(floor + np.tensordot(np.exp(2.0 * scales), basis, 1))
        if turn == 2:  # by now both are known well enough to be judged
            systematic, kept = _judged(errors, slope, weight)
        theta = np.zeros(2)
        theta[kept] = _least_squares(errors, slope[:, :, kept], weight)[0]
    scales = _likeliest(errors - slope @ theta, floor, basis, scales)
    fitted = {name: s * float(np.exp(scale)) for (name, s), scale in zip(sizes.items(), scales, strict=True)}
    values = dict(zip(_SYSTEMATIC, theta.tolist(), strict=True))
    return merge(straight, {"motion": _rounded(fitted), **_rounded(values)}), systematic


def _least_squares(errors: Array, slope: Array, weight: Array) -> tuple[Array, Array]:
    """The weighted least-squares solution (k,) of errors = slope @ x, and its covariance (k, k)."""
    cov = np.linalg.inv(np.einsum("nik,nij,njl->kl", slope, weight, slope))
    return cov @ np.einsum("nik,nij,nj->k", slope, weight, errors), cov


def _judged(errors: Array, slope: Array, weight: Array) -> tuple[dict[str, tuple[float, float]], list[int]]:
    values, cov = _least_squares(errors, slope, weight)
    sigmas = np.sqrt(np.diag(cov))
    named = {n: (float(v), float(s)) for n, v, s in zip(_SYSTEMATIC, values, sigmas, strict=True)}
    return named, np.flatnonzero(np.abs(values) > SIGNIFICANT * sigmas).tolist()


def _likeliest(errors: Array, floor: Array, basis: Array, start: Array) -> Array:
    """(6,) logarithms of the parameters' scales, standard normal a priori, likeliest for (N, 3) Gaussian errors."""

    def cost(scales: Array) -> float:
        covs = floor + np.tensordot(np.exp(2.0 * scales), basis, 1)
        return float(0.5 * (np.linalg.slogdet(covs)[1] + nees_world(errors, covs)).sum() + 0.5 * scales @ scales)

    return np.asarray(minimize(cost, start, method="L-BFGS-B", bounds=[(-8.0, 8.0)] * len(start)).x)


def landmark_errors(
    samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config, seed: int
) -> LandmarkErrors:
    """Compare the sightings of each sample's scan with the nearest of the true `landmarks` (M, 2) (report eq. 2)."""
    rng = np.random.default_rng(seed)  # the same draws each time, so that what differs is `assumed` alone
    kinds, errors, covs, false = [], [], [], 0
    for sample in samples:
        true = predict_points(sample.truth, landmarks)[0]  # (M, 2), robot's frame
        for sighting in extract(sample.scan, assumed, config.features, rng).sightings:
            gaps = sighting.z - true
            gap = gaps[np.argmin((gaps**2).sum(axis=1))] if len(gaps) else np.full(2, math.inf)
            if math.hypot(*gap) > _GATE_M:
                false += 1
                continue
            kinds.append(float(sighting.kind))
            errors.append(gap)
            covs.append(sighting.cov + _UNIT_SQ * np.eye(2))
    return LandmarkErrors(np.array(kinds), np.array(errors).reshape(-1, 2), np.array(covs).reshape(-1, 2, 2), false)


def fit_laser(
    samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config, seed: int
) -> AssumedConfig:
    """`assumed` with the range noise at which the sightings' mean NEES is 2.

    Line fitting takes a wall's returns to lie within RANSAC's threshold of it, so the range noise goes no further; what
    sightings err beyond that becomes `landmark_floor_m`. Raises CalibrationError where hardly a landmark was seen.
    """

    def too_sure(changes: dict[str, Any]) -> bool:
        found = landmark_errors(samples, landmarks, merge(assumed, changes), config, seed)
        return found.mean_nees > 2.0

    def crossing(low: float, high: float, changes: Callable[[float], dict[str, Any]]) -> float:
        """Where the sightings stop being too sure of themselves, by halving on a logarithmic scale."""
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if too_sure(changes(middle)) else (low, middle)
        return float(f"{high:.3g}")

    def with_range(range_m: float) -> dict[str, Any]:
        return {"laser": {"range_m": range_m}, "landmark_floor_m": 0.0}

    seen = len(landmark_errors(samples, landmarks, assumed, config, seed).errors)
    if seen < FEWEST_SAMPLES:
        raise CalibrationError(
            f"scene: found {seen} sightings of landmarks in {len(samples)} scans, allowed: a place that shows at least "
            f"{FEWEST_SAMPLES}"
        )
    widest = max(config.features.lines.ransac_threshold_m, 2.0 * _FINEST_M)
    if not too_sure(with_range(widest)):
        return merge(assumed, with_range(crossing(_FINEST_M, widest, with_range)))
    floor = crossing(_FINEST_M, _GATE_M, lambda floor_m: {**with_range(widest), "landmark_floor_m": floor_m})
    return merge(assumed, {**with_range(widest), "landmark_floor_m": floor})


def _rounded(values: dict[str, float]) -> dict[str, float]:
    """To four digits: more would claim what no hundred samples can know."""
    return {name: float(f"{value:.4g}") for name, value in values.items()}
