"""Normalised errors of estimates, and the band that their mean lies in if the covariances are right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.evaluation.metrics import nees_band
from sixthsense.slam.estimators import Estimate


def slow_but(quick: Any, every: Iterable[Any]) -> list[Any]:
    """Parameters of a test over all of them that is slow but for one."""
    return [one if one == quick else pytest.param(one, marks=pytest.mark.slow) for one in every]


def normalised(error: Array, cov: Array) -> float:
    """Squared Mahalanobis distance of an error (n,) with a covariance (n, n)."""
    return float(error @ np.linalg.solve(cov, error))


def error_of(estimate: Estimate, true: Pose, landmarks: Array | None = None) -> Array:
    """(3 + 2n,) of pose and landmarks, estimate less truth, world frame; (3,) without `landmarks`, true ones by id."""
    error = estimate.pose.array() - true.array()
    angles = np.array([2])
    if landmarks is not None:
        error = np.append(error, estimate.landmarks - landmarks[estimate.ids])
        angles = np.append(angles, 3 + 2 * np.flatnonzero(estimate.walls))
    error[angles] = wrap_angle(error[angles])
    return error


def assert_consistent(values: Sequence[float] | Array, dof: int, confidence: float = 0.99) -> None:
    """Assert that the mean of normalised errors of independent runs, each of `dof` numbers, lies in its band."""
    low, high = nees_band(len(values), dof, confidence)
    assert low < np.mean(values) < high, f"found {np.mean(values):.2f}, allowed: {low:.2f} to {high:.2f}"
