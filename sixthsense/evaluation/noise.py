"""Fits of the noise of odometry and laser to samples with known truth (report section 4.1)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from sixthsense.config import AssumedConfig, Config, merge
from sixthsense.config.errors import InputError
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, odometry
from sixthsense.core.se2 import between
from sixthsense.evaluation.effective import whitened_errors
from sixthsense.evaluation.metrics import nees_world, squares
from sixthsense.slam.features import extract

FEWEST_SAMPLES = 20
SIGNIFICANT = 3.0  # sigmas

_GATE_M = 0.25  # largest distance of an observation from its true landmark
_FINEST_M = 1e-3  # lower bound of the range noise
_HALVINGS = 10
_STEP = 1e-3  # of a systematic error, for its Jacobian
_UNIT_SQ = 1e-12  # (1 um)^2, (1 urad)^2, so that no covariance is singular
_OUTLIER = float(chi_square_quantile(0.999, 2))  # gate of the squared Mahalanobis distance of a match

# Initial values of the search for parameters whose assumed value is zero.
_MOTION = {
    "speed": 0.1,
    "turn_rate": 0.1,
    "slip_position_per_sqrt_m": 5e-3,
    "slip_position_per_sqrt_rad": 2e-3,
    "slip_heading_per_sqrt_m": 0.01,
    "slip_heading_per_sqrt_rad": 0.01,
}
_SYSTEMATIC = ("wheel_scale_error", "drift_rad_per_m")


@dataclass(frozen=True, slots=True)
class Sample:
    """One motion of about half a second and the scan at its end."""

    odometry: tuple[Pose, ...]
    """odometry poses at all control ticks, first and last included"""
    motion: Pose
    """the true `T_before_after`"""
    truth: Pose
    """`T_world_robot` at its end"""
    scan: Scan
    """scan at its end"""


@dataclass(frozen=True, slots=True)
class LandmarkErrors:
    """Errors of observations against the true landmarks (report eq. 2)."""

    kinds: Array
    """(K,) Kind of each"""
    errors: Array
    """(K, 2) observed minus true position, robot's frame, metres"""
    covs: Array
    """(K, 2, 2) covariance of each observation"""

    @property
    def nees(self) -> Array:
        """(K,) NEES, 2 on average if the covariances are correct."""
        return squares(self.errors, self.covs)

    @property
    def mean_nees(self) -> float:
        """Mean NEES of the observations within the 99.9 % gate; infinite without any."""
        nees = self.nees
        inside = nees[nees <= _OUTLIER]
        return float(inside.mean()) if len(inside) else math.inf

    def of(self, kind: Kind) -> Array:
        """(N, 2) errors of the observations of one kind."""
        return np.asarray(self.errors[self.kinds == kind])


@dataclass(frozen=True, slots=True)
class PropagationErrors:
    """Errors of odometry increments against the true motion (report eq. 1)."""

    errors: Array
    """(N, 3) true motion seen from that by odometry, metres and radians"""
    covs: Array
    """(N, 3, 3) covariances of the odometry"""

    @property
    def nees(self) -> Array:
        """(N,) NEES, 3 on average if the covariances are correct."""
        return nees_world(self.errors, self.covs)

    @property
    def whitened(self) -> Array:
        """(N, 3) errors with the identity as covariance, if the covariances are correct."""
        return whitened_errors(self.errors, self.covs)


def _composed(samples: Sequence[Sample], assumed: AssumedConfig) -> tuple[Array, Array]:
    """(N, 3) motions and (N, 3, 3) covariances of the samples by odometry, composed as in a filter at every tick."""
    motions, covs = np.zeros((len(samples), 3)), np.zeros((len(samples), 3, 3))
    for k, sample in enumerate(samples):
        total = STANDSTILL
        for before, after in itertools.pairwise(sample.odometry):
            total = total.then(odometry(before, after, assumed))
        motions[k], covs[k] = total.motion.array(), total.cov
    return motions, covs + _UNIT_SQ * np.eye(3)


def propagation_errors(samples: Sequence[Sample], assumed: AssumedConfig) -> PropagationErrors:
    """Errors of odometry against the true motion of each sample (report eq. 1)."""
    motions, covs = _composed(samples, assumed)
    return PropagationErrors(between(motions, np.array([s.motion.array() for s in samples])), covs)


def fit_motion(
    samples: Sequence[Sample], assumed: AssumedConfig
) -> tuple[AssumedConfig, dict[str, tuple[float, float]]]:
    """Fit the motion noise: the new assumptions, and estimate and sigma of each systematic error.

    The fit is maximum a posteriori. The covariance is linear in the squares of the noise parameters. The motion is
    nearly linear in the systematic errors, which follow from each covariance by generalised least squares. The mean
    NEES of the result is close to 3. A systematic error within three sigmas of zero is set to zero and counts as
    noise. Parameters that the samples cannot separate, such as slip and turn noise, stay close to the assumed values:
    the prior of each has a standard deviation of a factor of e.
    """
    straight = assumed.replaced(wheel_scale_error=0.0, drift_rad_per_m=0.0)
    noiseless = merge(straight, {"motion": dict.fromkeys(_MOTION, 0.0)})
    motions, floor = _composed(samples, noiseless)
    initial = {name: getattr(assumed.motion, name) or size for name, size in _MOTION.items()}
    parts = [_composed(samples, merge(noiseless, {"motion": {name: s}}))[1] - floor for name, s in initial.items()]
    basis = np.array(parts)  # (6, N, 3, 3)
    perturbed = [_composed(samples, merge(noiseless, {name: _STEP}))[0] for name in _SYSTEMATIC]
    jacobian = np.stack([between(motions, n) / _STEP for n in perturbed], axis=2)  # (N, 3, 2)
    errors = propagation_errors(samples, noiseless).errors

    def solved(scales: Array, kept: list[int]) -> tuple[Array, Array, float]:
        """Systematic errors, their covariance, and the negative logarithm of the posterior; of log scales (6,)."""
        covs, own = floor + np.tensordot(np.exp(2.0 * scales), basis, 1), jacobian[:, :, kept]
        weight = np.linalg.inv(covs)
        cov = np.linalg.inv(np.einsum("nik,nij,njl->kl", own, weight, own))
        values = cov @ np.einsum("nik,nij,nj->k", own, weight, errors)
        deviance = np.linalg.slogdet(covs)[1] + nees_world(errors - own @ values, covs)
        return values, cov, float(0.5 * deviance.sum() + 0.5 * scales @ scales)

    def fitted(kept: list[int]) -> Array:
        def cost(scales: Array) -> float:
            return solved(scales, kept)[2]

        bounds = [(-8.0, 8.0)] * len(initial)
        return np.asarray(minimize(cost, np.zeros(len(initial)), method="L-BFGS-B", bounds=bounds).x)

    values, cov, _ = solved(fitted([0, 1]), [0, 1])
    systematic = dict(zip(_SYSTEMATIC, zip(values.tolist(), np.sqrt(np.diag(cov)).tolist(), strict=True), strict=True))
    kept = [k for k, (value, sigma) in enumerate(systematic.values()) if abs(value) > SIGNIFICANT * sigma]
    scales = fitted(kept)
    noise = {name: s * float(np.exp(scale)) for (name, s), scale in zip(initial.items(), scales, strict=True)}
    found = dict(zip((_SYSTEMATIC[k] for k in kept), solved(scales, kept)[0].tolist(), strict=True))
    return merge(straight, {"motion": _rounded(noise), **_rounded(found)}), systematic


def landmark_errors(
    samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config
) -> LandmarkErrors:
    """Errors of the observations of each sample against the nearest true `landmarks` (M, 2) (report eq. 2)."""
    kinds, errors, covs = [], [], []
    for sample in samples:
        true, _, _ = predictions(sample.truth.triple(), landmarks, np.zeros(len(landmarks), dtype=np.bool_))  # robot
        for observation in extract(sample.scan, assumed, config.features).observations:
            gaps = observation.z - true
            gap = gaps[np.argmin((gaps**2).sum(axis=1))] if len(gaps) else np.full(2, math.inf)
            if math.hypot(*gap) <= _GATE_M:  # a false observation has no true landmark nearby
                kinds.append(float(observation.kind))
                errors.append(gap)
                covs.append(observation.cov + _UNIT_SQ * np.eye(2))
    return LandmarkErrors(np.array(kinds), np.array(errors).reshape(-1, 2), np.array(covs).reshape(-1, 2, 2))


def fit_laser(samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config) -> AssumedConfig:
    """`assumed` with the range noise at which the mean NEES of the observations is 2.

    The range noise is bounded by the threshold of lines, since line fitting rejects returns beyond it; larger errors of
    observations go into `landmark_floor_m`. Raises InputError for too few observations.
    """

    def with_range(range_m: float, floor_m: float = 0.0) -> AssumedConfig:
        return merge(assumed, {"laser": {"range_m": range_m}, "landmark_floor_m": floor_m})

    def crossing(low: float, high: float, changed: Callable[[float], AssumedConfig]) -> AssumedConfig:
        """Where the observations stop being overconfident, by bisection on a logarithmic scale."""
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            is_over = landmark_errors(samples, landmarks, changed(middle), config).mean_nees > 2.0
            low, high = (middle, high) if is_over else (low, middle)
        return changed(float(f"{high:.3g}"))

    count = len(landmark_errors(samples, landmarks, assumed, config).errors)
    if count < FEWEST_SAMPLES:
        found = f"found {count} observations of landmarks in {len(samples)} scans"
        raise InputError("scene", found, f"a place with at least {FEWEST_SAMPLES}")
    widest = max(config.features.lines.threshold_m, 2.0 * _FINEST_M)
    if landmark_errors(samples, landmarks, with_range(widest), config).mean_nees <= 2.0:
        return crossing(_FINEST_M, widest, with_range)
    return crossing(_FINEST_M, _GATE_M, lambda floor_m: with_range(widest, floor_m))


def _rounded(values: dict[str, float]) -> dict[str, float]:
    """Rounded to four digits, more than a hundred samples determine."""
    return {name: float(f"{value:.4g}") for name, value in values.items()}
