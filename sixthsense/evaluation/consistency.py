"""Is a covariance as large as the errors? The mean NEES of correlated poses, its band, and the verdict in words.

The mean of N correlated NEES scatters as that of N / tau independent ones, with tau = 1 + 2 sum of the autocorrelation
over all lags. The sum ends where the sum of two successive lags is no longer positive: the initial positive sequence
(Geyer, Practical Markov chain Monte Carlo, Statistical Science 7(4), 1992, section 3.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import nees_band, squares

LEAST_SAMPLES = 30.0
"""Effective samples below which tau itself is unknown: a run must be many times as long as its errors last.

With 30, tau is known to about 40 % (Madras and Sokal, J. Stat. Phys. 50, 1988), and a factor of 2 in the covariance of
a pose still lies beyond the band of the mean, 2.2 to 3.9.
"""

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


def effective_samples(nees: Sequence[Array]) -> float:
    """Number of independent samples whose mean scatters as that of these NEES, of runs that are independent: 1 to N.

    `nees` holds one (N_i,) series per run. The autocorrelation is pooled over the runs about their common mean, so
    that a difference between runs counts as an error that lasts a whole run. 0 without a sample.
    """
    count = sum(map(len, nees))
    if count == 0:
        return 0.0
    mean = float(np.concatenate(nees).mean())
    covariance = _autocovariance([one - mean for one in nees])
    if not covariance[0] > 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    return _bounded(count, 2.0 * float(correlation[: _initial(correlation)].sum()) - 1.0)


def effective_samples_of_errors(whitened: Sequence[Array]) -> tuple[float, float]:
    """Of the errors' squares and of the errors: numbers of independent samples, each 1 to N.

    `whitened` holds one (N_i, d) series per run: errors divided by their stated sigmas, or by the root of their
    covariance. A consistent error has mean 0, which need not be estimated, so that one that keeps its sign over the
    whole run is seen, as it is not by `effective_samples` of one run. The autocorrelation of the squares of Gaussian
    errors is the square of that of the errors; it does not depend on the scale of the covariance.
    """
    count = sum(map(len, whitened))
    if count == 0:
        return 0.0, 0.0
    columns = range(whitened[0].shape[1])
    covariance = np.array([_autocovariance([one[:, k] for one in whitened]) for k in columns])
    if not (covariance[:, 0] > 0.0).any():
        return 1.0, 1.0
    correlation = covariance.sum(axis=0) / covariance[:, 0].sum()
    end = _initial(correlation)
    squares = np.sum(covariance[:, :end] ** 2, axis=0) / np.sum(covariance[:, 0] ** 2)
    of_squares, of_errors = (_bounded(count, 2.0 * float(one.sum()) - 1.0) for one in (squares, correlation[:end]))
    return of_squares, of_errors


def effective_number(nees: Sequence[Array], whitened: Sequence[Array]) -> float:
    """The smaller one of both numbers for the NEES of `whitened` errors; the band of their mean follows from it."""
    return min(effective_samples(nees), effective_samples_of_errors(whitened)[0])


def whitened_errors(error: Array, cov: Array) -> Array:
    """(K, d) errors with the identity as covariance, of (K, d) errors with (K, d, d) covariances of full rank."""
    sigmas = np.sqrt(np.einsum("kii->ki", cov))
    correlation = cov / (sigmas[:, :, None] * sigmas[:, None, :])
    # The addition keeps a correlation of rounded numbers definite, and is far below what a mean can tell.
    root = np.linalg.cholesky(correlation + 1e-9 * np.eye(cov.shape[1]))
    return np.asarray(np.linalg.solve(root, (error / sigmas)[:, :, None])[:, :, 0])


def _autocovariance(series: Sequence[Array]) -> Array:
    """(L,) sums of products at each lag, up to the longest series, over all series, about 0."""
    longest = max(map(len, series))
    size = 1 << (2 * longest - 1).bit_length()
    power = sum(np.abs(np.fft.rfft(one, size)) ** 2 for one in series)
    return np.asarray(np.fft.irfft(power, size)[:longest])


def _initial(correlation: Array) -> int:
    """Number of lags in the initial positive sequence: pairs of lags, up to the first whose sum is not positive."""
    pairs = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0.0)
    return max(1, 2 * int(ends[0]) if len(ends) else len(correlation))


def _bounded(count: int, tau: float) -> float:
    """Samples over their correlation time, from 1 to all of them: a band of more would claim too much."""
    return float(min(max(count / max(tau, 1.0), 1.0), count))
