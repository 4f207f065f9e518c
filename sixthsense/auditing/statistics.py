"""Errors beside stated covariances: the consistency of the pose and of each axis, over time, and of two systems.

Two systems without a truth are compared with each other: if both are honest and independent, the difference of their
poses has the sum of both covariances. Errors that both share, as by the same odometry, cancel: they hide
overconfidence, and never feign it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.poses import Frame, heading
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation import consistency as effective
from sixthsense.evaluation.consistency import LEAST_SAMPLES, Consistency, Outcome, consistency, whitened_errors

LEVELS = (0.5, 0.9, 0.95)
"""of the regions whose coverage is computed"""
AXES = {
    ("world", 3): ("x", "y", "heading"),
    ("body", 3): ("forward", "left", "heading"),
    ("world", 6): ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z"),
    ("body", 6): ("forward", "left", "up", "roll", "pitch", "yaw"),
}
"""names of the axes of an error, by frame and size"""

CONFIDENCE = 0.95
"""of each one-sided statement"""
LEAST_OF_A_PAIR = 0.5 * LEAST_SAMPLES
"""Effective samples: a number of 30 is itself estimated to 40 %, and the power stands beside the verdict."""
TIMES = (1.5, 2.0, 3.0)
"""of one system's stated sigmas, for which the power is computed"""


@dataclass(frozen=True, slots=True)
class Findings:
    """The statistics of all runs of an audit together."""

    poses: int
    """number of them"""
    pose: Consistency
    """of the whole pose, the degrees of freedom of an alignment taken off"""
    axes: dict[str, Consistency]
    """by name of the axis"""
    removed: float
    """share of the NEES that the alignment has taken"""
    coverage: dict[float, float]
    """share of the errors inside the region that is to hold this share"""

    @property
    def outcome(self) -> Outcome:
        """Whether the band of the mean NEES holds it; too short to tell from fewer than 30 effective samples."""
        return self.pose.outcome

    @property
    def factor(self) -> float:
        """By which the covariance should be multiplied."""
        return self.pose.factor

    def deviating(self) -> list[str]:
        """The axes beyond what chance explains, each with a chance of 5 % over their number."""
        # Three normal sigmas stand for 5 % over at most six axes.
        wide = {name: replace(one, samples=one.samples * (1.96 / 2.64) ** 2) for name, one in self.axes.items()}
        known = [name for name, one in self.axes.items() if one.samples >= LEAST_SAMPLES]
        return [name for name in known if not wide[name].interval[0] <= 1.0 <= wide[name].interval[1]]


def findings(runs: Sequence[Errors], align: Align, frame: Frame) -> Findings:
    """The statistics of runs that are independent of each other."""
    whitened = [whitened_errors(run.error, run.cov) for run in runs]
    lengths = np.array([len(one) for one in whitened], dtype=np.float64)
    removed = 0.0
    if align == "all":  # as of a mean that is estimated
        numbers = np.array([effective.effective_samples_of_errors([one])[1] for one in whitened])
        removed = min(0.5, float(np.sum(lengths / numbers) / lengths.sum()))

    def judged(parts: Sequence[tuple[Array, Array]]) -> Consistency:
        found = consistency(parts)
        return replace(found, nees=found.nees / (1.0 - removed))

    pose = judged([(run.error, run.cov) for run in runs])
    turned = [run.in_axes(frame) for run in runs]
    axes = {
        name: judged([(error[:, k : k + 1], cov[:, k : k + 1, k : k + 1]) for error, cov in turned])
        for k, name in enumerate(AXES[frame, pose.dof])
    }
    nees = np.concatenate([run.nees for run in runs])
    coverage = {level: float(np.mean(nees <= chi_square_quantile(level, pose.dof))) for level in LEVELS}
    return Findings(int(lengths.sum()), pose, axes, removed, coverage)


def heading_dependence(errors: Errors) -> float:
    """How surely the NEES of a run depends on heading: chi-square with 2 degrees of freedom if it does not.

    It is the share of the NEES's variance that cos and sin of twice the heading explain, times the effective number of
    samples: a covariance that is turned by the heading, or is not and should be, repeats after half a turn.
    """
    nees, twice = errors.nees, 2.0 * heading(errors.turns)
    basis = np.column_stack([np.ones_like(nees), np.cos(twice), np.sin(twice)])
    fit = basis @ np.linalg.lstsq(basis, nees, rcond=None)[0]
    variance = float(np.var(nees))
    return effective.effective_samples([nees]) * float(np.var(fit)) / variance if variance > 0.0 else 0.0


def is_other_frame(runs: Sequence[Errors], others: Sequence[Errors]) -> bool:
    """Whether the covariances may be those of the other frame: read so, errors fit better, and do not tell the heading.

    `others` has the same errors with the covariances read in the other frame. Of covariances that are no longer than
    wide both readings are equal but for rounding.
    """
    limit = float(chi_square_quantile(0.95, 2 * len(runs)))
    read, other = (sum(map(heading_dependence, one)) for one in (runs, others))
    means = [float(np.concatenate([run.nees for run in one]).mean()) for one in (runs, others)]
    return read > limit and other < read and means[1] < (1.0 - 1e-6) * means[0]


@dataclass(frozen=True, slots=True)
class PairFindings:
    """What two systems say of each other."""

    outcome: Outcome
    """overconfident: at least one is; cautious: at least one is, or their errors depend on each other"""
    samples: float
    """effective number of samples of the differences, if both are honest"""
    least: float
    """at least one system's errors are so many times its stated sigmas, with 95 %; 0 to 1: perhaps none"""
    if_other_honest: tuple[float, float]
    """the same for the first system if the second is honest, and for the second if the first is"""
    power: dict[float, float]
    """chance to be found if one system's errors are so many times its stated sigmas, the smaller one of the two"""


def pair_findings(found: Findings, errors: Errors) -> PairFindings:
    """Judge the differences of two systems: the first one's covariance is a part of that of the differences."""
    of_first = errors.of_estimate
    assert of_first is not None
    # Of honest systems the whitened differences are standard normal: their own correlation gives the samples.
    samples, dof = effective.effective_samples_of_errors([whitened_errors(errors.error, errors.cov)])[0], found.pose.dof
    low, high = (
        found.factor * samples * dof / float(chi_square_quantile(tail, samples * dof))
        for tail in (CONFIDENCE, 1.0 - CONFIDENCE)
    )
    share = float(np.einsum("kii->k", np.linalg.solve(errors.cov, of_first)).mean()) / dof
    outcome: Outcome = "overconfident" if low > 1.0 else "cautious" if high < 1.0 else "consistent"
    return PairFindings(
        "too short to tell" if samples < LEAST_OF_A_PAIR else outcome,
        samples,
        math.sqrt(low),
        (_least(low, share), _least(low, 1.0 - share)),
        {times: power(errors.cov, of_first, samples, times) for times in TIMES},
    )


def _least(factor: float, share: float) -> float:
    """The factor of sigmas of a system with a share of the covariance, if the other part has the factor 1."""
    return math.sqrt(max(factor - (1.0 - share), 0.0) / max(share, 1e-12))


def power(cov: Array, of_first: Array, samples: float, times: float) -> float:
    """The chance that one system is found whose errors are so many times its stated sigmas, by chi-square.

    The smaller chance of both systems. The sum of squares of `samples` differences with covariances (N, d, d) is a sum
    of weighted chi-squares; it has the mean and the variance of a scaled chi-square (Satterthwaite 1946).
    """
    dof, chances = cov.shape[1], []
    limit = float(chi_square_quantile(CONFIDENCE, samples * dof))
    for part in (of_first, cov - of_first):
        weights = 1.0 + (times**2 - 1.0) * np.linalg.eigvals(np.linalg.solve(cov, part)).real  # (N, d)
        mean, square = float(weights.mean()), float((weights**2).mean())
        chances.append(_survival(limit * mean / square, samples * dof * mean**2 / square))
    return min(chances)


def _survival(limit: float, freedom: float) -> float:
    from scipy.special import gammaincc  # here, since it takes a while to load

    return float(gammaincc(0.5 * freedom, 0.5 * limit))
