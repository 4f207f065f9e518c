"""Two systems on one drive without a truth: whether they differ by more than both covariances allow.

If both are honest and independent, the difference of their poses has the sum of both covariances. Errors that both
share, as by the same odometry, cancel: they hide overconfidence, and never feign it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sixthsense.auditing.pairing import Errors
from sixthsense.auditing.statistics import Findings
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.consistency import LEAST_SAMPLES, Outcome, effective_samples_of_errors, whitened_errors

CONFIDENCE = 0.95
"""of each one-sided statement"""
LEAST_OF_A_PAIR = 0.5 * LEAST_SAMPLES
"""Effective samples: a number of 30 is itself estimated to 40 %, and the power stands beside the verdict."""
TIMES = (1.5, 2.0, 3.0)
"""of one system's stated sigmas, for which the power is computed"""


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
    samples, dof = effective_samples_of_errors([whitened_errors(errors.error, errors.cov)])[0], found.pose.dof
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
