"""Interchangeable estimators of pose and map behind one protocol, made by the name in the configuration."""

from __future__ import annotations

from collections.abc import Callable

from sixthsense.config import ISAM2Config
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.names import ESTIMATORS as NAMES
from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.base import Estimate, Estimator, Filter, LandmarkPrior, Link, Smoother

__all__ = [
    "ESTIMATORS",
    "Estimate",
    "Estimator",
    "EstimatorFactory",
    "Filter",
    "LandmarkPrior",
    "Link",
    "Smoother",
    "make_estimator",
    "register_estimator",
]

ESTIMATORS = NAMES.shipped

EstimatorFactory = Callable[[Pose, Array], Estimator]

_registered: dict[str, EstimatorFactory] = {}


def register_estimator(name: str, factory: EstimatorFactory) -> None:
    """Allow `name` in the configuration's field `estimator`, in this process, and make it by `factory`.

    `factory` is called with the start, a `Pose` `T_world_robot`, and its covariance (3, 3), world frame, m and rad,
    which is zero in a run; an `Estimator`'s class can serve as factory. Registering a name again replaces its factory.
    Raises ValueError for a shipped name, or a text that is not a valid name.
    """
    NAMES.add(name)
    _registered[name] = factory


def make_estimator(name: str, start: Pose, start_cov: Array, isam2: ISAM2Config | None = None) -> Estimator:
    """Make the named estimator at a start `T_world_robot`.

    `start_cov` (3, 3), world frame, m and rad, may be zero; `isam2` are the smoother's settings. Raises ValueError
    that lists the known names.
    """
    if name in _registered:
        return _registered[name](start, start_cov)
    if name == "ekf":
        from sixthsense.slam.estimators.ekf import EKF

        return EKF(start, start_cov)
    if name in ("ekf-fej", "ekf-oc"):
        from sixthsense.slam.estimators.ekf_variants import FirstEstimatesEKF, ObservabilityConstrainedEKF

        return (FirstEstimatesEKF if name == "ekf-fej" else ObservabilityConstrainedEKF)(start, start_cov)
    if name == "ekf-invariant":
        from sixthsense.slam.estimators.ekf_variants import InvariantEKF

        return InvariantEKF(start, start_cov)
    if name == "isam2":
        from sixthsense.slam.estimators.isam2 import ISAM2

        return ISAM2(start, start_cov, isam2 or ISAM2Config())
    raise InputError("estimator", f"found {name!r}", ", ".join(NAMES), nearest(name, NAMES))
