"""Checks that a matrix is a covariance."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array

COVARIANCE_SLACK = 1e-9  # by which rounding may miss symmetry and positive eigenvalues, in terms of the largest entry


def check_covariance(name: str, value: Array) -> Array:
    """(3, 3) of a pose or a motion as float64; ValueError, naming it, unless it is symmetric and nowhere negative."""
    cov = np.asarray(value, dtype=np.float64)
    if cov.shape != (3, 3):
        raise ValueError(f"{name}: expected shape (3, 3), got {cov.shape}")
    fault = covariance_fault(cov, lowest=-COVARIANCE_SLACK)
    if fault:
        raise ValueError(f"{name}: found {fault}, allowed: a covariance, symmetric, no eigenvalue below 0")
    return cov


def covariance_fault(cov: Array, lowest: float) -> str:
    """What is wrong with a covariance, if anything; `lowest` is that of its eigenvalues in terms of the largest."""
    if not np.isfinite(cov).all():
        return "a value that is not finite"
    scale = float(np.abs(cov).max())
    if np.abs(cov - cov.T).max() > COVARIANCE_SLACK * scale:
        return "an asymmetric matrix"
    smallest = float(np.linalg.eigvalsh(cov)[0])
    return f"an eigenvalue of {smallest:.3g}" if smallest < lowest * scale else ""
