"""Errors beside stated covariances: NEES with its band, factors with their intervals, by axis and over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sixthsense.auditing import rotations
from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.poses import Frame
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.effective import (
    LEAST_SAMPLES,
    effective_number,
    effective_samples,
    effective_samples_of_errors,
    whitened_errors,
)
from sixthsense.evaluation.metrics import nees_band

Outcome = Literal["consistent", "overconfident", "cautious", "no verdict"]

PARTS = 5
"""equal parts of the time over which the NEES is told"""
AXES = {
    ("world", 3): ("x", "y", "heading"),
    ("body", 3): ("forward", "left", "heading"),
    ("world", 6): ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z"),
    ("body", 6): ("forward", "left", "up", "roll", "pitch", "yaw"),
}
"""names of the axes of an error, by frame and size"""


@dataclass(frozen=True, slots=True)
class Factor:
    """By which the covariance of an axis, or of the whole pose, should be multiplied."""

    value: float
    """mean of the squared errors over the stated variance"""
    interval: tuple[float, float]
    """95 %"""
    samples: float
    """effective number of samples"""

    @property
    def sigmas(self) -> tuple[float, float]:
        """The interval of the factor of the sigmas."""
        return math.sqrt(self.interval[0]), math.sqrt(self.interval[1])


@dataclass(frozen=True, slots=True)
class Findings:
    """The statistics of all runs of an audit together."""

    dof: int
    """3 or 6"""
    poses: int
    """number of them"""
    samples: float
    """effective number of samples"""
    nees: float
    """mean, the degrees of freedom of an alignment taken off"""
    band: tuple[float, float]
    """95 %, of the mean of as many independent NEES"""
    inside: float
    """share of the poses whose NEES lies below the 95 % quantile"""
    factor: Factor
    """of the whole covariance"""
    axes: dict[str, Factor]
    """by name of the axis"""
    parts: tuple[float, ...]
    """mean NEES in equal parts of the time"""
    removed: float
    """share of the NEES that the alignment has taken"""
    shared: float
    """share of the variance of the mean that the first pose has"""

    @property
    def outcome(self) -> Outcome:
        """Whether the factor's interval holds 1; no verdict from fewer than 30 effective samples."""
        if self.samples < LEAST_SAMPLES:
            return "no verdict"
        low, high = self.factor.interval
        return "overconfident" if low > 1.0 else "cautious" if high < 1.0 else "consistent"


def findings(runs: Sequence[Errors], align: Align, frame: Frame) -> Findings:
    """The statistics of runs that are independent of each other."""
    nees, whitened = [run.nees for run in runs], [whitened_errors(run.error, run.cov) for run in runs]
    dof, count = runs[0].error.shape[1], sum(map(len, nees))
    removed = _removed(whitened) if align == "all" else 0.0
    weights = np.array([len(one) / count for one in nees])
    shared = float(np.sum(weights**2 * [run.shared for run in runs]))
    samples = 1.0 / (1.0 / _heavy_tailed(nees, effective_number(nees, whitened), dof) + shared)
    normal = [_normalized(run, frame) for run in runs]
    axes = {}
    for k, name in enumerate(AXES[frame, dof]):
        ones = [one[:, k : k + 1] for one in normal]
        squares = [one[:, 0] ** 2 for one in ones]
        own = 1.0 / (1.0 / _heavy_tailed(squares, effective_number(squares, ones), 1) + shared)
        axes[name] = factor(float(np.concatenate(squares).mean()) / (1.0 - removed), own, 1)
    together = np.concatenate(nees)
    mean = float(together.mean()) / (1.0 - removed)
    below = float(np.mean(together <= chi_square_quantile(0.95, dof)))
    return Findings(
        dof, count, samples, mean, nees_band(samples, dof), below, factor(mean / dof, samples, dof), axes,
        _parts(runs, nees), removed, shared,
    )  # fmt: skip


def factor(value: float, samples: float, dof: int) -> Factor:
    """The factor of a covariance from the mean NEES per degree of freedom.

    With s the true factor, samples x dof x value / s is chi-square with samples x dof degrees of freedom for so many
    independent Gaussian errors, so that the interval holds 1 exactly where the mean NEES lies in its band.
    """
    freedom = samples * dof
    low, high = (value * freedom / float(chi_square_quantile(tail, freedom)) for tail in (0.975, 0.025))
    return Factor(value, (low, high), samples)


def heading_dependence(errors: Errors) -> float:
    """How surely the NEES of a run depends on heading: chi-square with 2 degrees of freedom if it does not.

    It is the share of the NEES's variance that cos and sin of twice the heading explain, times the effective number of
    samples: a covariance that is turned by the heading, or is not and should be, repeats after half a turn.
    """
    nees, twice = errors.nees, 2.0 * rotations.yaw(errors.orientations)
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


def _heavy_tailed(nees: Sequence[Array], samples: float, dof: int) -> float:
    """Fewer samples if the NEES scatter more than chi-square around their mean: the factor is the less certain."""
    together = np.concatenate(nees)
    mean, variance = float(together.mean()), float(together.var())
    expected = 2.0 * mean**2 / dof
    return max(1.0, samples * min(1.0, expected / variance)) if variance > 0.0 else samples


def _removed(whitened: Sequence[Array]) -> float:
    """Share of the squared errors that an alignment by all poses takes: as of a mean that is estimated."""
    numbers = [effective_samples_of_errors([one])[1] for one in whitened]
    lengths = np.array([len(one) for one in whitened], dtype=np.float64)
    return min(0.5, float(np.sum(lengths / numbers) / lengths.sum()))


def _normalized(run: Errors, frame: Frame) -> Array:
    """(N, d) errors over their stated sigmas, in the axes of a frame."""
    error, cov = run.in_axes(frame)
    return np.asarray(error / np.sqrt(np.einsum("kii->ki", cov)))


def _parts(runs: Sequence[Errors], nees: Sequence[Array]) -> tuple[float, ...]:
    """Mean NEES of all runs in equal parts of each run's time; NaN for a part without poses."""
    sums, counts = np.zeros(PARTS), np.zeros(PARTS)
    for run, values in zip(runs, nees, strict=True):
        since = (run.stamps_ns - run.stamps_ns[0]).astype(np.float64)
        part = np.minimum((PARTS * since / max(since[-1], 1.0)).astype(np.int64), PARTS - 1)
        sums += np.bincount(part, values, PARTS)
        counts += np.bincount(part, minlength=PARTS)
    return tuple((sums / np.where(counts > 0.0, counts, np.nan)).tolist())
