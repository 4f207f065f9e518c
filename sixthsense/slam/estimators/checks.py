"""Checks of what estimators with optional capabilities are given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sixthsense.core.covariance import COVARIANCE_SLACK, are_covariances, check_covariance, covariance_fault
from sixthsense.core.geometry import Array
from sixthsense.core.sensor import SENSOR_PARAMETERS, SensorEstimate
from sixthsense.core.wheels import PARAMETERS, WheelEstimate
from sixthsense.slam.estimators.base import LandmarkPrior, Link


def check_prior(prior: LandmarkPrior, has_begun: bool) -> None:
    """Raise RuntimeError if the estimator has begun, ValueError for an invalid prior."""
    if has_begun:
        raise RuntimeError("start_from: found a call after the first motion or update, allowed: before both")
    n = len(prior.ids)
    if len(np.unique(prior.ids)) != n:
        raise ValueError("prior: found ids that repeat, allowed: each landmark once")
    if prior.landmarks.shape != (n, 2) or not np.isfinite(prior.landmarks).all():
        raise ValueError(f"prior: found means {prior.landmarks.shape}, allowed: finite numbers, ({n}, 2)")
    fault = covariance_fault(prior.cov, lowest=-COVARIANCE_SLACK) if n else None
    if prior.cov.shape != (2 * n, 2 * n) or fault:
        raise ValueError(f"prior: found {fault or prior.cov.shape}, allowed: a covariance, ({2 * n}, {2 * n})")


def check_wheels(prior: WheelEstimate, has_begun: bool) -> None:
    """Raise RuntimeError if the estimator has begun, ValueError for an invalid covariance of the prior."""
    _check_parameters("wheels", prior.cov, PARAMETERS, has_begun)


def check_sensor(prior: SensorEstimate, has_begun: bool) -> None:
    """Raise RuntimeError if the estimator has begun, ValueError for an invalid covariance of the prior."""
    _check_parameters("sensor", prior.cov, SENSOR_PARAMETERS, has_begun)


def _check_parameters(name: str, cov: Array, count: int, has_begun: bool) -> None:
    if has_begun:
        raise RuntimeError(f"estimate_{name}: found a call after the first motion or update, allowed: before both")
    fault = covariance_fault(cov, lowest=-COVARIANCE_SLACK)
    if cov.shape != (count, count) or fault:
        raise ValueError(f"prior of {name}: found {fault or cov.shape}, allowed: a covariance, ({count}, {count})")


def check_links(links: Sequence[Link], poses: int) -> None:
    """Raise KeyError for a link to a pose that is not one of the `poses` so far, ValueError for an invalid one."""
    are_good = are_covariances([link.relative.cov for link in links])
    for k, link in enumerate(links):
        for pose in (link.before, link.after):
            if not 0 <= pose < poses:
                raise KeyError(f"link {k}: found pose {pose}, allowed: 0 to {poses - 1}")
        if link.before == link.after:
            raise ValueError(f"link {k}: found pose {link.after} at both ends, allowed: two poses")
        if not are_good:
            check_covariance(f"link {k}", link.relative.cov)
        if not np.isfinite(link.relative.motion.array()).all():
            raise ValueError(f"link {k}: found {link.relative.motion}, allowed: finite numbers")
        if not link.loss_scale > 0.0:
            raise ValueError(f"link {k}: found loss_scale {link.loss_scale}, allowed: above 0")
