"""Errors beside stated covariances: the consistency of the pose and of each axis, and over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.poses import Frame, heading
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.consistency import (
    LEAST_SAMPLES,
    Consistency,
    Outcome,
    consistency,
    effective_samples,
    effective_samples_of_errors,
    whitened_errors,
)

LEVELS = (0.5, 0.9, 0.95)
"""of the regions whose coverage is computed"""
AXES = {
    ("world", 3): ("x", "y", "heading"),
    ("body", 3): ("forward", "left", "heading"),
    ("world", 6): ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z"),
    ("body", 6): ("forward", "left", "up", "roll", "pitch", "yaw"),
}
"""names of the axes of an error, by frame and size"""

_PARTS = 5


@dataclass(frozen=True, slots=True)
class Score:
    """How well the stated covariance describes the errors of the pose."""

    coverage: dict[float, float]
    """share of the errors inside the region that is to hold this share"""
    log_score: float
    """mean of the negative logarithm of the stated density at the errors, nats (m, rad): less is better"""
    scaled_log_score: float
    """the same if the covariance were multiplied by its factor, the least that any multiple has"""


@dataclass(frozen=True, slots=True)
class Findings:
    """The statistics of all runs of an audit together."""

    poses: int
    """number of them"""
    pose: Consistency
    """of the whole pose, the degrees of freedom of an alignment taken off"""
    axes: dict[str, Consistency]
    """by name of the axis"""
    parts: tuple[float, ...]
    """mean NEES in equal parts of the time; NaN for a part without poses"""
    removed: float
    """share of the NEES that the alignment has taken"""
    score: Score
    """coverage and log score of the pose"""

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
        numbers = np.array([effective_samples_of_errors([one])[1] for one in whitened])
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
    return Findings(int(lengths.sum()), pose, axes, _over_time(runs), removed, _score(runs))


def _score(runs: Sequence[Errors]) -> Score:
    nees, dof = np.concatenate([run.nees for run in runs]), runs[0].error.shape[1]
    volumes = np.concatenate([np.linalg.slogdet(run.cov)[1] for run in runs])
    volume, mean = dof * math.log(2.0 * math.pi) + float(volumes.mean()), float(nees.mean())
    coverage = {level: float(np.mean(nees <= chi_square_quantile(level, dof))) for level in LEVELS}
    scaled = 0.5 * (volume + dof * math.log(max(mean / dof, 1e-300)) + dof)
    return Score(coverage, 0.5 * (volume + mean), scaled)


def _over_time(runs: Sequence[Errors]) -> tuple[float, ...]:
    """Mean NEES of all runs in equal parts of each run's time; NaN for a part without poses."""
    sums, counts = np.zeros(_PARTS), np.zeros(_PARTS)
    for run in runs:
        since = (run.stamps_ns - run.stamps_ns[0]).astype(np.float64)
        span = (0.0, max(since[-1], 1.0))
        sums += np.histogram(since, _PARTS, span, weights=run.nees)[0]
        counts += np.histogram(since, _PARTS, span)[0]
    return tuple((sums / np.where(counts > 0.0, counts, np.nan)).tolist())


def heading_dependence(errors: Errors) -> float:
    """How surely the NEES of a run depends on heading: chi-square with 2 degrees of freedom if it does not.

    It is the share of the NEES's variance that cos and sin of twice the heading explain, times the effective number of
    samples: a covariance that is turned by the heading, or is not and should be, repeats after half a turn.
    """
    nees, twice = errors.nees, 2.0 * heading(errors.turns)
    basis = np.column_stack([np.ones_like(nees), np.cos(twice), np.sin(twice)])
    fit = basis @ np.linalg.lstsq(basis, nees, rcond=None)[0]
    variance = float(np.var(nees))
    return effective_samples([nees]) * float(np.var(fit)) / variance if variance > 0.0 else 0.0


def is_other_frame(runs: Sequence[Errors], others: Sequence[Errors]) -> bool:
    """Whether the covariances may be those of the other frame: read so, errors fit better, and do not tell the heading.

    `others` has the same errors with the covariances read in the other frame. Of covariances that are no longer than
    wide both readings are equal but for rounding.
    """
    limit = float(chi_square_quantile(0.95, 2 * len(runs)))
    read, other = (sum(map(heading_dependence, one)) for one in (runs, others))
    means = [float(np.concatenate([run.nees for run in one]).mean()) for one in (runs, others)]
    return read > limit and other < read and means[1] < (1.0 - 1e-6) * means[0]
