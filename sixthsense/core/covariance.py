"""Checks that a matrix is a covariance, its root information, and quantiles of distances that it whitens."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from scipy.special import gammaincinv

from sixthsense.core.se2 import Array


def chi_square_quantile(probability: Any, dof: Any) -> Any:
    """Quantile of the chi-square distribution with `dof` degrees of freedom; both are numbers or arrays.

    The bits are those of `scipy.stats.chi2.ppf`, whose import takes most of a second.
    """
    return 2.0 * gammaincinv(0.5 * dof, probability)


SIGNIFICANT = 3.0
"""sigmas, beyond which a deviation is not taken for chance"""


def difference_covariance(joint: Array, first: int, second: int) -> Array:
    """(2, 2) covariance of the difference of two landmarks, of the joint one (2n, 2n) of n."""
    a, b = slice(2 * first, 2 * first + 2), slice(2 * second, 2 * second + 2)
    return np.asarray(joint[a, a] + joint[b, b] - joint[a, b] - joint[b, a])


def plus_blocks(matrix: Array, blocks: Array) -> Array:
    """`matrix` (2m, 2m), which is changed, plus `blocks` (m, 2, 2) on its diagonal; much faster than `block_diag`."""
    each = np.arange(len(blocks))
    matrix.reshape(len(blocks), 2, len(blocks), 2)[each, :, each] += blocks
    return matrix


COVARIANCE_SLACK = 1e-9
"""Tolerance of symmetry and of positive eigenvalues, relative to the largest entry."""


def root_information(cov: Array) -> Array:
    """(..., n, n) W of covariances (..., n, n), with W^T W = cov^-1: it whitens errors.

    Of the covariance's Cholesky factor: where one direction is known to millimetres and another not at all, rounding
    makes the inverse of the covariance itself indefinite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))


def check_covariance(name: str, value: Array) -> Array:
    """The (3, 3) covariance of a pose or a motion as float64; ValueError naming it if it is invalid."""
    cov = np.ascontiguousarray(value, dtype=np.float64)
    if cov.shape != (3, 3):
        raise ValueError(f"{name}: expected shape (3, 3), got {cov.shape}")
    if not _is_definite(cov) and (fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK)):
        raise ValueError(f"{name}: found {fault}, allowed: a covariance, symmetric, no eigenvalue below 0")
    return cov


@numba.njit(cache=True, error_model="numpy")
def _is_definite(cov: Array) -> bool:
    """Whether a matrix (3, 3) is finite, symmetric and positive definite, by the pivots of its factors."""
    first, f = cov[0, 0], cov[2, 0] / cov[0, 0]
    second = cov[1, 1] - cov[1, 0] ** 2 / first
    third = cov[2, 2] - f * cov[2, 0] - (cov[2, 1] - f * cov[1, 0]) ** 2 / second
    off = abs(cov[0, 1] - cov[1, 0]) + abs(cov[0, 2] - cov[2, 0]) + abs(cov[1, 2] - cov[2, 1])
    is_positive = min(first, second, third) > 0.0 and first + second + third < math.inf
    return bool(is_positive and off <= COVARIANCE_SLACK * first)


def covariance_fault(cov: Array, lowest: float) -> str:
    """Why a matrix is no covariance, or an empty text; `lowest` allowed eigenvalue, relative to the largest entry."""
    if not np.isfinite(cov).all():
        return "a value that is not finite"
    scale = float(np.abs(cov).max())
    if np.abs(cov - cov.T).max() > COVARIANCE_SLACK * scale:
        return "an asymmetric matrix"
    smallest = float(np.linalg.eigvalsh(cov)[0])
    return f"an eigenvalue of {smallest:.3g}" if smallest < lowest * scale else ""


def landmark_covariances(joint: Array) -> Array:
    """(M, 2, 2) covariances of the landmarks of a joint covariance (3 + 2M, 3 + 2M) that has the pose first."""
    count = (len(joint) - 3) // 2
    return np.asarray(np.einsum("kikj->kij", joint[3:, 3:].reshape(count, 2, count, 2)).copy())
