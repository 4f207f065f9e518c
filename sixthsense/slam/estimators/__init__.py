"""Interchangeable back ends behind one protocol."""

from __future__ import annotations

from collections.abc import Callable

from sixthsense.config import ISAM2Config
from sixthsense.config.names import ESTIMATORS as NAMES
from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.base import Estimate, Estimator

__all__ = ["ESTIMATORS", "Estimate", "Estimator", "EstimatorFactory", "make_estimator", "register_estimator"]

ESTIMATORS = NAMES.shipped

EstimatorFactory = Callable[[Pose, Array], Estimator]

_OWN: dict[str, EstimatorFactory] = {}


def register_estimator(name: str, factory: EstimatorFactory) -> None:
    """Let the configuration's field `estimator` be `name`, in this process, and make it by `factory`.

    `factory` is called with the start, a `Pose` `T_world_robot`, and its covariance (3, 3), world frame, m and rad,
    which a run has at zero: the class of an `Estimator` will do. A name of one's own may be registered again, and then
    is the newer one's. ValueError for a name that ships, or that is no name.
    """
    NAMES.add(name)
    _OWN[name] = factory


def make_estimator(name: str, start: Pose, start_cov: Array, isam2: ISAM2Config | None = None) -> Estimator:
    """Make the named back end at a known start, `T_world_robot`.

    `start_cov` (3, 3), world frame, m and rad, may be zero; `isam2` are the smoother's settings. ValueError lists the
    known names.
    """
    if name in _OWN:
        return _OWN[name](start, start_cov)
    if name == "ekf":
        from sixthsense.slam.estimators.ekf import EKF

        return EKF(start, start_cov)
    if name == "ekf-fej":
        from sixthsense.slam.estimators.ekf_fej import FirstEstimatesEKF

        return FirstEstimatesEKF(start, start_cov)
    if name == "ekf-oc":
        from sixthsense.slam.estimators.ekf_oc import ObservabilityConstrainedEKF

        return ObservabilityConstrainedEKF(start, start_cov)
    if name == "ekf-invariant":
        from sixthsense.slam.estimators.ekf_invariant import InvariantEKF

        return InvariantEKF(start, start_cov)
    if name == "isam2":
        from sixthsense.slam.estimators.isam2 import ISAM2

        return ISAM2(start, start_cov, isam2 or ISAM2Config())
    raise ValueError(f"estimator: found {name!r}, allowed: {NAMES}")
