"""Interchangeable back ends behind one protocol."""

from __future__ import annotations

from sixthsense.config import ISAM2Config
from sixthsense.estimators.base import Estimate, Estimator
from sixthsense.geometry import Array, Pose

__all__ = ["ESTIMATORS", "Estimate", "Estimator", "make_estimator"]

ESTIMATORS = ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2")


def make_estimator(name: str, start: Pose, start_cov: Array, isam2: ISAM2Config | None = None) -> Estimator:
    """Make the named back end at a known start; `start_cov` (3, 3), world frame, may be zero.

    `isam2` are the smoother's settings. ValueError lists the known names.
    """
    if name == "ekf":
        from sixthsense.estimators.ekf import EKF

        return EKF(start, start_cov)
    if name == "ekf-fej":
        from sixthsense.estimators.ekf_fej import FirstEstimatesEKF

        return FirstEstimatesEKF(start, start_cov)
    if name == "ekf-oc":
        from sixthsense.estimators.ekf_oc import ObservabilityConstrainedEKF

        return ObservabilityConstrainedEKF(start, start_cov)
    if name == "ekf-invariant":
        from sixthsense.estimators.ekf_invariant import InvariantEKF

        return InvariantEKF(start, start_cov)
    if name == "isam2":
        from sixthsense.estimators.isam2 import ISAM2

        return ISAM2(start, start_cov, isam2 or ISAM2Config())
    raise ValueError(f"estimator: found {name!r}, allowed: {', '.join(ESTIMATORS)}")
