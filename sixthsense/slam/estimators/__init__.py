"""Interchangeable estimators of pose and map behind one protocol."""

from sixthsense.slam.estimators.base import (
    Estimate,
    Estimator,
    Filter,
    LandmarkPrior,
    Link,
    Smoother,
)
from sixthsense.slam.estimators.factory import ESTIMATORS, EstimatorFactory, make_estimator, register_estimator

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
