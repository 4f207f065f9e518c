"""Interchangeable estimators of pose and map behind one protocol."""

from sixthsense.slam.estimators.base import (
    Estimate,
    Estimator,
    LandmarkPrior,
    Link,
    PoseGraphEstimator,
    PriorMapEstimator,
    ReducibleEstimator,
    SensorEstimator,
    WheelEstimator,
    estimates_sensor,
    estimates_wheels,
    keeps_poses,
    takes_out_poses,
    takes_prior_map,
)
from sixthsense.slam.estimators.factory import ESTIMATORS, EstimatorFactory, make_estimator, register_estimator

__all__ = [
    "ESTIMATORS",
    "Estimate",
    "Estimator",
    "EstimatorFactory",
    "LandmarkPrior",
    "Link",
    "PoseGraphEstimator",
    "PriorMapEstimator",
    "ReducibleEstimator",
    "SensorEstimator",
    "WheelEstimator",
    "estimates_sensor",
    "estimates_wheels",
    "keeps_poses",
    "make_estimator",
    "register_estimator",
    "takes_out_poses",
    "takes_prior_map",
]
