"""Is a covariance as large as the errors? The mean NEES of correlated poses, its band, and the verdict in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.effective import LEAST_SAMPLES, effective_number, whitened_errors
from sixthsense.evaluation.metrics import nees_band, squares

Outcome = Literal["consistent", "overconfident", "cautious", "too short to tell"]


@dataclass(frozen=True, slots=True)
class Consistency:
    """A mean NEES, and how many independent samples it is worth: band, factor and verdict follow from these."""

    nees: float
    """mean normalised estimation error squared"""
    samples: float
    """effective number of samples"""
    dof: int = 3
    """degrees of freedom of one NEES, the mean of a consistent one"""

    @property
    def band(self) -> tuple[float, float]:
        """95 % band of the mean NEES of a consistent estimator."""
        return nees_band(self.samples, self.dof)

    @property
    def factor(self) -> float:
        """Factor by which the covariance would have to be multiplied."""
        return self.nees / self.dof

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the factor; it holds 1 exactly where the mean NEES lies in its band.

        With s the true factor, samples x NEES / s is chi-square with samples x dof degrees of freedom for so many
        independent Gaussian errors.
        """
        freedom = self.samples * self.dof
        low, high = (self.factor * freedom / float(chi_square_quantile(tail, freedom)) for tail in (0.975, 0.025))
        return low, high

    @property
    def sigmas(self) -> tuple[float, float]:
        """95 % interval of the errors over the stated sigmas."""
        return math.sqrt(self.interval[0]), math.sqrt(self.interval[1])

    @property
    def outcome(self) -> Outcome:
        """The verdict; none from fewer than 30 effective samples."""
        if not self.samples >= LEAST_SAMPLES:
            return "too short to tell"
        low, high = self.interval
        return "overconfident" if low > 1.0 else "cautious" if high < 1.0 else "consistent"

    def __str__(self) -> str:
        low, high = map(short, self.band)
        said = f"{self.outcome}: NEES {short(self.nees)}, {low} to {high} is consistent"
        if self.outcome != "too short to tell":
            least, most = map(short, self.sigmas)
            return f"{said}; errors are {least} to {most} times the stated sigmas"
        said += f"; worth {short(self.samples)} independent samples, {LEAST_SAMPLES:.0f} are needed"
        if self.nees > float(chi_square_quantile(0.999, self.dof)):
            said += "; yet no chance: look for an error that stays, such as another frame, clock or mount"
        return said


def consistency(runs: Sequence[tuple[Array, Array]]) -> Consistency:
    """The mean NEES of runs that are independent of each other, with its effective number of samples.

    Each run has errors (N, d) and their stated covariances (N, d, d) of full rank. NEES that scatter more than
    chi-square around their mean count as fewer samples. One sample of NaN without an error.
    """
    nees = [squares(*run) for run in runs]
    together = np.concatenate([np.zeros(0), *nees])
    if not len(together):
        return Consistency(math.nan, 0.0)
    dof, mean, variance = runs[0][0].shape[1], float(together.mean()), float(together.var())
    samples = effective_number(nees, [whitened_errors(*run) for run in runs])
    if variance > 0.0:
        samples = max(1.0, samples * min(1.0, 2.0 * mean**2 / dof / variance))
    return Consistency(mean, samples, dof)


def short(value: float) -> str:
    """Three digits at most, without an exponent."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}" if value >= 10.0 else f"{value:.2f}"
