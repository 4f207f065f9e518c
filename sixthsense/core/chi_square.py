"""Quantiles of the chi-square distribution."""

from __future__ import annotations

from typing import Any

from scipy.special import gammaincinv


def chi_square_quantile(probability: float, dof: Any) -> Any:
    """Quantile of the chi-square distribution with `dof` degrees of freedom, a number or an array.

    The bits are those of `scipy.stats.chi2.ppf`, whose import takes most of a second.
    """
    return 2.0 * gammaincinv(0.5 * dof, probability)
