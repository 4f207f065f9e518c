"""Interchangeable back ends behind one protocol."""

from __future__ import annotations

from sixthsense.estimators.base import Estimate, Estimator
from sixthsense.geometry import Array, Pose

__all__ = ["ESTIMATORS", "Estimate", "Estimator", "make_estimator"]

ESTIMATORS = ("ekf",)


def make_estimator(name: str, start: Pose, start_cov: Array) -> Estimator:
    """Make the named back end at a known start; `start_cov` (3, 3), world frame. ValueError lists the known names."""
    if name == "ekf":
        from sixthsense.estimators.ekf import EKF

        return EKF(start, start_cov)
    raise ValueError(f"estimator: found {name!r}, allowed: {', '.join(ESTIMATORS)}")
