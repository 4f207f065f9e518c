"""Covariances of poses: their change under a motion, checks that a matrix is one, and quantiles of their distances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from scipy.special import gammaincinv

from sixthsense.core.geometry import Array


def chi_square_quantile(probability: float, dof: Any) -> Any:
    """Quantile of the chi-square distribution with `dof` degrees of freedom, a number or an array.

    The bits are those of `scipy.stats.chi2.ppf`, whose import takes most of a second.
    """
    return 2.0 * gammaincinv(0.5 * dof, probability)


COVARIANCE_SLACK = 1e-9
"""Tolerance of symmetry and of positive eigenvalues, relative to the largest entry."""


@numba.njit(cache=True, error_model="numpy")
def transformed(cov: Array, c: float, s: float, u: float, v: float) -> Array:
    """`J @ cov @ J.T` (3, 3) for the Jacobian J of a motion of the plane, [[c, -s, u], [s, c, v], [0, 0, 1]].

    Written out: for matrices of this size a call of BLAS takes longer than the product.
    """
    left, out = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        left[0, k] = c * cov[0, k] - s * cov[1, k] + u * cov[2, k]
        left[1, k] = s * cov[0, k] + c * cov[1, k] + v * cov[2, k]
        left[2, k] = cov[2, k]
    for k in range(3):
        out[k, 0] = c * left[k, 0] - s * left[k, 1] + u * left[k, 2]
        out[k, 1] = s * left[k, 0] + c * left[k, 1] + v * left[k, 2]
        out[k, 2] = left[k, 2]
    return out


@numba.njit(cache=True, error_model="numpy")
def composed_covariance(first: Array, later: Array, heading: float, x: float, y: float) -> Array:
    """(3, 3) of a motion by (x, y) at a heading, of covariance `later`, after one of covariance `first`."""
    c, s = math.cos(heading), math.sin(heading)
    return transformed(first, 1.0, 0.0, -s * x - c * y, c * x - s * y) + transformed(later, c, s, 0.0, 0.0)


@numba.njit(cache=True, error_model="numpy")
def turned_covariance(cov: Array, angle: float) -> Array:
    """(3, 3) symmetric: a covariance in axes turned by an angle."""
    turned = transformed(cov, math.cos(angle), math.sin(angle), 0.0, 0.0)
    return 0.5 * (turned + turned.T)


def root_information(cov: Array) -> Array:
    """(..., n, n) W of covariances (..., n, n), with W^T W = cov^-1: it whitens errors.

    Of the covariance's Cholesky factor: where one direction is known to millimetres and another not at all, rounding
    makes the inverse of the covariance itself indefinite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))


def check_covariance(name: str, value: Array) -> Array:
    """The (3, 3) covariance of a pose or a motion as float64; ValueError naming it if it is invalid."""
    cov = np.asarray(value, dtype=np.float64)
    if cov.shape != (3, 3):
        raise ValueError(f"{name}: expected shape (3, 3), got {cov.shape}")
    fault = covariance_fault(cov, lowest=-COVARIANCE_SLACK)
    if fault:
        raise ValueError(f"{name}: found {fault}, allowed: a covariance, symmetric, no eigenvalue below 0")
    return cov


def covariance_fault(cov: Array, lowest: float) -> str:
    """Why a matrix is no covariance, or an empty text; `lowest` allowed eigenvalue, relative to the largest entry."""
    if not np.isfinite(cov).all():
        return "a value that is not finite"
    asymmetry, scale, smallest = _extremes(np.asarray(cov, dtype=np.float64))
    if asymmetry > COVARIANCE_SLACK * scale:
        return "an asymmetric matrix"
    return f"an eigenvalue of {smallest:.3g}" if smallest < lowest * scale else ""


@numba.njit(cache=True, error_model="numpy")
def _extremes(cov: Array) -> tuple[float, float, float]:
    """The largest difference from the transpose, the largest entry, and the smallest eigenvalue."""
    return np.abs(cov - cov.T).max(), np.abs(cov).max(), np.linalg.eigvalsh(cov)[0]


def are_covariances(values: Sequence[Array]) -> bool:
    """Whether all are valid (3, 3) covariances, by one call for all; `check_covariance` says what is wrong with one."""
    if not values or any(np.shape(value) != (3, 3) for value in values):
        return False
    covs = np.array(values, dtype=np.float64)
    if not np.isfinite(covs).all():
        return False
    slack = COVARIANCE_SLACK * np.abs(covs).max(axis=(1, 2))
    is_symmetric = np.abs(covs - covs.transpose(0, 2, 1)).max(axis=(1, 2)) <= slack
    return bool((is_symmetric & (np.linalg.eigvalsh(covs)[:, 0] >= -slack)).all())
