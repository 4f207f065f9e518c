"""Two systems on one drive without a truth: whether they differ by more than both covariances allow.

If both are honest and independent, the difference of their poses has the sum of both covariances. Errors that both
share, as by the same odometry, cancel: they hide overconfidence, and never feign it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sixthsense.auditing import rotations
from sixthsense.auditing.pairing import Errors
from sixthsense.auditing.statistics import Findings, Outcome
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds
from sixthsense.evaluation.effective import (
    LEAST_SAMPLES,
    effective_number,
    effective_samples_of_errors,
    whitened_errors,
)

CONFIDENCE = 0.95
"""of each one-sided statement"""
LEAST_OF_A_PAIR = 0.5 * LEAST_SAMPLES
"""Effective samples: a number of 30 is itself estimated to 40 %, and the power stands beside the verdict."""
TIMES = (1.5, 2.0, 3.0)
"""of one system's stated sigmas, for which the power is told"""

_DRAWS, _MOST_ROWS = 2000, 400
_HORIZONS = 6


@dataclass(frozen=True, slots=True)
class Hat:
    """A system's own factor by the three-cornered hat, if the errors of all three are independent."""

    factor: float
    """of the covariance"""
    interval: tuple[float, float]
    """95 %"""


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
    """chance to be told if one system's errors are so many times its stated sigmas, the smaller one of the two"""
    horizons: tuple[tuple[float, float], ...]
    """s, and the mean square of the difference of relative motions over that which independent ends allow"""
    hats: tuple[Hat, ...] = ()
    """of each system, with a third one"""


def pair_findings(
    found: Findings, errors: Errors, of_first: Array, positions: Array, hats: Sequence[Hat]
) -> PairFindings:
    """Judge the differences of two systems.

    `of_first` (N, d, d) is the first one's part in the covariance of the differences, whose other part is the second
    one's; `positions` (N, n) are those of the second.
    """
    # Of honest systems the whitened differences are standard normal: their own correlation says what they are worth.
    samples = effective_samples_of_errors([whitened_errors(errors.error, errors.cov)])[0]
    freedom = samples * found.dof
    low, high = (
        found.factor.value * freedom / float(chi_square_quantile(tail, freedom))
        for tail in (CONFIDENCE, 1.0 - CONFIDENCE)
    )
    share = float(np.einsum("kii->k", np.linalg.solve(errors.cov, of_first)).mean()) / found.dof
    outcome: Outcome = "overconfident" if low > 1.0 else "cautious" if high < 1.0 else "consistent"
    return PairFindings(
        "no verdict" if samples < LEAST_OF_A_PAIR else outcome,
        samples,
        math.sqrt(low),
        (_least(low, share), _least(low, 1.0 - share)),
        {times: power(errors.cov, of_first, samples, times) for times in TIMES},
        _horizons(errors, positions),
        tuple(hats),
    )


def _least(factor: float, share: float) -> float:
    """The factor of sigmas of a system with a share of the covariance, if the other part has the factor 1."""
    return math.sqrt(max(factor - (1.0 - share), 0.0) / max(share, 1e-12))


def power(cov: Array, of_first: Array, samples: float, times: float) -> float:
    """The chance that one system is told whose errors are so many times its stated sigmas, by simulation.

    Of as many independent differences as the trajectory is worth, with covariances (N, d, d) taken evenly from it;
    the smaller chance of both systems.
    """
    rows = np.linspace(0, len(cov) - 1, min(max(round(samples), 1), _MOST_ROWS)).astype(np.int64)
    cov, of_first = cov[rows], of_first[rows]
    white = np.random.default_rng(0).standard_normal((_DRAWS, *cov.shape[:2]))
    limit = float(chi_square_quantile(CONFIDENCE, cov.shape[0] * cov.shape[1]))
    chances = []
    for part in (of_first, cov - of_first):
        # The squares of errors with that covariance, in sigmas of the stated one, have these weights.
        root = np.linalg.cholesky(cov)
        inner = np.linalg.solve(root, np.linalg.solve(root, part).transpose(0, 2, 1))
        weights = 1.0 + (times**2 - 1.0) * np.linalg.eigvalsh(inner)  # (rows, d)
        chances.append(float(np.mean(np.einsum("skd,kd->s", white**2, weights) > limit)))
    return min(chances)


def _horizons(errors: Errors, positions: Array) -> tuple[tuple[float, float], ...]:
    """Mean squares of the differences of relative motions, over horizons from a pose to half of the trajectory."""
    count, dof = errors.error.shape
    steps = np.unique(np.geomspace(1, max(count // 2, 1), _HORIZONS).astype(np.int64))
    found = []
    for step in steps[steps < count].tolist():
        carry = rotations.levers(positions[step:] - positions[:-step])
        moved = errors.error[step:] - (carry @ errors.error[:-step, :, None])[:, :, 0]
        cov = errors.cov[step:] + carry @ errors.cov[:-step] @ rotations.transposed(carry)
        ratio = float(np.einsum("ki,ki->k", moved, np.linalg.solve(cov, moved[:, :, None])[:, :, 0]).mean()) / dof
        apart_s = seconds(float(np.median(errors.stamps_ns[step:] - errors.stamps_ns[:-step])))
        found.append((apart_s, ratio))
    return tuple(found)


def three_cornered_hat(second: Errors, third: Errors, covs: Sequence[Array]) -> tuple[Hat, ...]:
    """The factors of three systems: `second` and `third` have their differences from the first, at the same stamps.

    `covs` has the stated covariances (N, d, d) of all three, in the axes of these differences. The product of two
    differences from one system has the mean of its own square, if errors of different systems are independent: a factor
    below 0 is a sign that they are not (Gray and Allan, Proc. 28th Frequency Control Symposium, 1974).
    """
    total = covs[0] + covs[1] + covs[2]
    other = third.error - second.error
    found = []
    for (left, right), cov in zip(
        ((second.error, third.error), (-second.error, other), (-third.error, -other)), covs, strict=True
    ):
        products = np.einsum("ki,ki->k", left, np.linalg.solve(total, right[:, :, None])[:, :, 0])
        stated = float(np.einsum("kii->k", np.linalg.solve(total, cov)).mean())
        samples = effective_number([products], [whitened_errors(left, total), whitened_errors(right, total)])
        spread = 1.96 * float(products.std()) / math.sqrt(samples)
        mean = float(products.mean())
        found.append(Hat(mean / stated, ((mean - spread) / stated, (mean + spread) / stated)))
    return tuple(found)
