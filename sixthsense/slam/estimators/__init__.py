"""Interchangeable estimators of pose and map behind one protocol."""

from sixthsense.slam.estimators.base import (
    Estimate,
    Estimator,
    Link,
    PoseGraphEstimator,
    WheelEstimator,
    estimates_wheels,
    keeps_poses,
)
from sixthsense.slam.estimators.factory import ESTIMATORS, EstimatorFactory, make_estimator, register_estimator

__all__ = [
    "ESTIMATORS",
    "Estimate",
    "Estimator",
    "EstimatorFactory",
    "Link",
    "PoseGraphEstimator",
    "WheelEstimator",
    "estimates_wheels",
    "keeps_poses",
    "make_estimator",
    "register_estimator",
]
