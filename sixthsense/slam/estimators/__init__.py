"""Interchangeable estimators of pose and map behind one protocol, made by the name in the configuration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sixthsense.config.parts import ESTIMATORS as PARTS
from sixthsense.config.tree import make_part
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
]

ESTIMATORS = tuple(PARTS)
"""names of the shipped ones"""

EstimatorFactory = Callable[..., Estimator]
"""An estimator's class, or a function that makes one: of the start, a `Pose` `T_world_robot`, its covariance (3, 3),
world frame, m and rad, which is zero in a run, and of an object of its `Options`, if it has any."""


def make_estimator(estimator: str | EstimatorFactory, start: Pose, start_cov: Array, options: Any = None) -> Estimator:
    """Make an estimator, by its name or its class, at a start `T_world_robot`.

    `start_cov` (3, 3), world frame, m and rad, may be zero; `options` are an object of the estimator's `Options`, by
    default one without arguments. Raises InputError that lists the known names.
    """
    made: Estimator = make_part(PARTS, estimator, start, start_cov, options=options)
    return made
