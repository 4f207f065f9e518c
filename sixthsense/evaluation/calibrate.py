"""Calibration: drive the robot where the truth is known, and fit the noise that estimators assume (report section 4.1).

Only this step uses the truth, as a calibration with a measuring tape would. The result is a normal configuration.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sixthsense.config import AssumedConfig, Config, as_table, merge
from sixthsense.config.errors import InputError
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, odometry
from sixthsense.core.se2 import between
from sixthsense.core.source import Command
from sixthsense.evaluation.metrics import squares, true_landmarks
from sixthsense.simulation.mission import placement
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.features import extract

PERIOD_S = 0.5  # duration of a sample, as in the report
FEWEST_SAMPLES = 20
SIGNIFICANT = 3.0  # sigmas

_STARTS = 100
_GATE_M = 0.25  # largest distance of an observation from its true landmark
_FINEST_M = 1e-3  # lower bound of the range noise
_HALVINGS = 10
_STEP = 1e-3  # of a systematic error, for its Jacobian
_UNIT_SQ = 1e-12  # (1 um)^2, (1 urad)^2, so that no covariance is singular
_OUTLIER = float(chi_square_quantile(0.999, 2))  # gate of the squared Mahalanobis distance of a match

# Initial values of the search for parameters whose assumed value is zero.
_MOTION = {
    "speed": 0.1, "turn_rate": 0.1, "slip_position_per_sqrt_m": 5e-3, "slip_position_per_sqrt_rad": 2e-3,
    "slip_heading_per_sqrt_m": 0.01, "slip_heading_per_sqrt_rad": 0.01,
}  # fmt: skip
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
class Errors:
    """Errors of samples with the covariances that are assumed."""

    errors: Array
    """(K, 3) true motion seen from that by odometry, or (K, 2) observed minus true position, robot's frame; m, rad"""
    covs: Array
    """(K, d, d) assumed"""
    kinds: Array
    """(K,) Kind of each observation; empty for motions"""

    @property
    def nees(self) -> Array:
        """(K,) NEES, d on average if the covariances are correct."""
        return squares(self.errors, self.covs)

    @property
    def mean_nees(self) -> float:
        """Mean NEES, of observations of those within the 99.9 % gate; infinite without any."""
        nees = self.nees[self.nees <= _OUTLIER] if len(self.kinds) else self.nees
        return float(nees.mean()) if len(nees) else math.inf

    def of(self, kind: Kind) -> Array:
        """(N, 2) errors of the observations of one kind."""
        return np.asarray(self.errors[self.kinds == kind])


@dataclass(frozen=True, slots=True)
class Calibration:
    """Result of a calibration."""

    assumed: AssumedConfig
    """the fitted assumptions"""
    systematic: dict[str, tuple[float, float]]
    """estimate and sigma of each systematic error of the wheels, also of those set to zero"""
    propagation: tuple[Errors, Errors]
    """errors of odometry before and after"""
    landmarks: tuple[Errors, Errors]
    """errors of observations before and after"""


def calibrate(config: Config, samples: int = 100, on_sample: Callable[[], object] | None = None) -> Calibration:
    """Drive the robot of `config` in its scene and fit `assumed` to its noise; `on_sample` is called after each sample.

    Raises InputError for an invalid scene or start, and for too few samples or landmarks.
    """
    if samples < FEWEST_SAMPLES:
        raise InputError("samples", f"found {samples}", f"at least {FEWEST_SAMPLES}")
    world_rng, drive_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
    walls, driven = drive_samples(config, samples, world_rng, drive_rng, on_sample)
    landmarks = true_landmarks(walls)
    # Points have known true positions, so the laser's noise is fitted to them; walls have the same noise.
    config = merge(config, {"features": {"landmarks": "corners"}})
    with threadpool_limits(limits=1, user_api="blas"):  # as in the loop, for reproducibility
        motion, systematic = fit_motion(driven, config.assumed)
        both = config.assumed, fit_laser(driven, landmarks, motion, config)
        before, after = (propagation_errors(driven, assumed) for assumed in both)
        seen_before, seen_after = (landmark_errors(driven, landmarks, assumed, config) for assumed in both)
    return Calibration(both[1], systematic, (before, after), (seen_before, seen_after))


def drive_samples(
    config: Config,
    samples: int,
    world_rng: np.random.Generator,
    drive_rng: np.random.Generator,
    on_sample: Callable[[], object] | None = None,
) -> tuple[Array, list[Sample]]:
    """Drive with a random speed and a random turn rate to the left in each sample; return the walls and the samples.

    A sample that ends at a wall does not count, and the robot begins again at its start.
    """
    scene, robot = load_scene(config.scene, config.map_unknown), config.robot
    start, radius_m = placement(config, scene)
    out: list[Sample] = []
    for _ in range(_STARTS):
        world = World(scene.walls, start, radius_m, config, world_rng, scene.glass)
        tick = world.step(Command())
        while tick is not None and not tick.collided and len(out) < samples:
            began, track = tick, [tick.odometry]
            command = Command(drive_rng.random() * robot.speed, drive_rng.random() * robot.turn_rate)
            # A sample ends at the first scan after its duration, so a slow laser makes longer samples.
            while (tick := world.step(command)) is not None and not tick.collided:
                track.append(tick.odometry)
                if tick.scan is not None and tick.stamp_ns - began.stamp_ns >= round(PERIOD_S * 1e9) - 1000:
                    assert began.truth is not None and tick.truth is not None
                    out.append(Sample(tuple(track), began.truth.inverse() @ tick.truth, tick.truth, tick.scan))
                    if on_sample is not None:
                        on_sample()
                    break
        if len(out) == samples:
            return scene.walls, out
    raise InputError("start", f"the robot touched a wall {_STARTS} times", "a start with room around it")


def _composed(samples: Sequence[Sample], assumed: AssumedConfig) -> tuple[Array, Array]:
    """(N, 3) motions and (N, 3, 3) covariances of the samples by odometry, composed as in a filter at every tick."""
    motions, covs = np.zeros((len(samples), 3)), np.zeros((len(samples), 3, 3))
    for k, sample in enumerate(samples):
        total = STANDSTILL
        for before, after in itertools.pairwise(sample.odometry):
            total = total.then(odometry(before, after, assumed))
        motions[k], covs[k] = total.motion.array(), total.cov
    return motions, covs + _UNIT_SQ * np.eye(3)


def propagation_errors(samples: Sequence[Sample], assumed: AssumedConfig) -> Errors:
    """Errors of odometry against the true motion of each sample (report eq. 1)."""
    motions, covs = _composed(samples, assumed)
    return Errors(between(motions, np.array([s.motion.array() for s in samples])), covs, np.zeros(0))


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
    from scipy.optimize import minimize  # here, since it takes a while to load

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
        deviance = np.linalg.slogdet(covs)[1] + squares(errors - own @ values, covs)
        return values, cov, float(0.5 * deviance.sum() + 0.5 * scales @ scales)

    def fitted(kept: list[int]) -> Array:
        def cost(scales: Array) -> float:
            return solved(scales, kept)[2]

        return np.asarray(minimize(cost, np.zeros(len(initial)), bounds=[(-8.0, 8.0)] * len(initial)).x)

    values, cov, _ = solved(fitted([0, 1]), [0, 1])
    systematic = dict(zip(_SYSTEMATIC, zip(values.tolist(), np.sqrt(np.diag(cov)).tolist(), strict=True), strict=True))
    kept = [k for k, (value, sigma) in enumerate(systematic.values()) if abs(value) > SIGNIFICANT * sigma]
    scales = fitted(kept)
    noise = {name: s * float(np.exp(scale)) for (name, s), scale in zip(initial.items(), scales, strict=True)}
    found = dict(zip((_SYSTEMATIC[k] for k in kept), solved(scales, kept)[0].tolist(), strict=True))
    return merge(straight, {"motion": _rounded(noise), **_rounded(found)}), systematic


def landmark_errors(samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config) -> Errors:
    """Errors of the observations of each sample against the nearest true `landmarks` (M, 2) (report eq. 2)."""
    rows: list[tuple[float, Array, Array]] = []
    for sample in samples:
        true, _, _ = predictions(sample.truth.triple(), landmarks, np.zeros(len(landmarks), dtype=np.bool_))  # robot
        for observation in extract(sample.scan, assumed, config.features).observations:
            gaps = observation.z - true
            lengths = np.hypot(*gaps.T)
            if lengths.min(initial=math.inf) <= _GATE_M:  # a false observation has no true landmark nearby
                rows.append((float(observation.kind), gaps[lengths.argmin()], observation.cov + _UNIT_SQ * np.eye(2)))
    kinds, errors, covs = zip(*rows, strict=True) if rows else ([], [], [])
    return Errors(np.array(errors).reshape(-1, 2), np.array(covs).reshape(-1, 2, 2), np.array(kinds))


def fit_laser(samples: Sequence[Sample], landmarks: Array, assumed: AssumedConfig, config: Config) -> AssumedConfig:
    """`assumed` with the range noise at which the mean NEES of the observations is 2.

    The range noise is bounded by the threshold of lines, since line fitting rejects returns beyond it; larger errors of
    observations go into `landmark_floor_m`. Raises InputError for too few observations.
    """

    def with_range(range_m: float, floor_m: float = 0.0) -> AssumedConfig:
        return merge(assumed, {"laser": {"range_m": range_m}, "landmark_floor_m": floor_m})

    def is_over(changed: AssumedConfig) -> bool:
        return landmark_errors(samples, landmarks, changed, config).mean_nees > 2.0

    count = len(landmark_errors(samples, landmarks, assumed, config).errors)
    if count < FEWEST_SAMPLES:
        found = f"found {count} observations of landmarks in {len(samples)} scans"
        raise InputError("scene", found, f"a place with at least {FEWEST_SAMPLES}")
    widest = max(config.features.lines.threshold_m, 2.0 * _FINEST_M)
    is_floor = is_over(with_range(widest))
    changed = partial(with_range, widest) if is_floor else with_range
    low, high = _FINEST_M, _GATE_M if is_floor else widest
    for _ in range(_HALVINGS):  # where they stop being overconfident, by bisection on a logarithmic scale
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_over(changed(middle)) else (low, middle)
    return changed(float(f"{high:.3g}"))


def _rounded(values: dict[str, float]) -> dict[str, float]:
    """Rounded to four digits, more than a hundred samples determine."""
    return {name: float(f"{value:.4g}") for name, value in values.items()}


def as_partial_config(found: Calibration, config: Config) -> dict[str, Any]:
    """The fields set by a calibration as a nested table, the content of a file for `load_config`."""
    assumed = as_table(found.assumed)
    fitted = {name: assumed[name] for name in (*_SYSTEMATIC, "landmark_floor_m", "motion")}
    fitted["laser"] = {name: assumed["laser"][name] for name in ("distribution", "range_m")}
    return {"preset": config.preset, "assumed": fitted}


def summary(found: Calibration) -> list[str]:
    """Lines with the counts, systematic errors, covariances (report eq. 3) and NEES before and after."""
    (odometry, odometry_after), (seen, seen_after) = found.propagation, found.landmarks
    means = f"mean NEES {odometry.mean_nees:.2f} before, {odometry_after.mean_nees:.2f} after"
    lines = [f"propagation: {len(odometry.errors)} samples, {means}; 3 is consistent"]
    for name, (value, sigma) in found.systematic.items():
        kept = "kept" if getattr(found.assumed, name) else f"set to 0: within {SIGNIFICANT:.0f} sigma"
        lines.append(f"{name}: {value:.4f} +- {sigma:.4f}, {kept}")
    before = f"{len(seen.errors)} observations, mean NEES {seen.mean_nees:.2f} before"
    lines.append(f"landmarks: {before}; {len(seen_after.errors)}, {seen_after.mean_nees:.2f} after; 2 is consistent")
    for kind in (Kind.CORNER, Kind.END):
        errors = 1e3 * seen_after.of(kind)
        (xx, xy), (_, yy) = errors.T @ errors / max(len(errors), 1)
        moments = f"xx {xx:.1f} xy {xy:.1f} yy {yy:.1f} mm^2"
        lines.append(f"{kind.name.lower()}: {len(errors)} observations, covariance with zero mean {moments}")
    return lines


def check_output(file: Path, overwrite: bool) -> None:
    """Raise InputError if `file` or its figure, a PNG of the same name, exists or is not allowed as an output."""
    if file.name in ("", "..") or file.suffix == ".png" or file.is_dir():
        raise InputError("out", f"found {str(file)!r}", "the name of a file, such as noise.toml")
    for one in (file, file.with_suffix(".png")):
        if one.exists() and not overwrite:
            raise InputError("out", f"{one} exists", "a new file, or `overwrite`")
