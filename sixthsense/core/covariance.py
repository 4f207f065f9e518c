"""Checks that a matrix is a covariance."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array

COVARIANCE_SLACK = 1e-9
"""Tolerance of symmetry and of positive eigenvalues, relative to the largest entry."""


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
    scale = float(np.abs(cov).max())
    if np.abs(cov - cov.T).max() > COVARIANCE_SLACK * scale:
        return "an asymmetric matrix"
    smallest = float(np.linalg.eigvalsh(cov)[0])
    return f"an eigenvalue of {smallest:.3g}" if smallest < lowest * scale else ""
