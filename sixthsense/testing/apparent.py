"""Laws of apparent landmarks: an error of a point's shape that stays while its side stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Bend, Kind, Observation
from sixthsense.slam.estimators import Estimator, EstimatorFactory
from sixthsense.testing.estimation import assert_same, joint_state, make
from sixthsense.testing.laws import Laws
from sixthsense.testing.posterior import BOTH, START, START_COV, drive

LAWS = Laws(needs_walls=True)

STAYS = np.array([[3.0e-4, 1.1e-4], [1.1e-4, 1.9e-4]])
NEW = np.array([[4.0e-5, -1.0e-5], [-1.0e-5, 2.0e-5]])
"""(2, 2) parts of the covariance of an observation: what stays while the side stays, and what is drawn anew"""
_NONE = np.zeros((2, 2))


@LAWS.law
def an_error_of_shape_without_a_size_changes_no_bit(name: str) -> None:
    estimators = [make(name, START, START_COV) for _ in range(2)]
    for odometry, scan in drive(BOTH, 6)[0]:
        flat = {i: replace(seen, bend=Bend(_NONE, _NONE, 1, 0.7)) for i, seen in scan.items() if not seen.is_wall}
        for estimator, seen in zip(estimators, (scan, {**scan, **flat}), strict=True):
            estimator.predict(odometry)
            estimator.update(seen)
    plain, flat_state = (joint_state(estimator) for estimator in estimators)
    assert_same(plain, flat_state)


def seen_from(sides: Sequence[int], name: str | EstimatorFactory) -> Estimator:
    """An estimator at a known pose that has seen a point from these sides; the robot sees it in one place always.

    The errors of two sides have nothing in common.
    """
    estimator = make(name, Pose(0.4, -0.7, 0.0), np.zeros((3, 3)))
    before = None
    for side in sides:
        renewal = _NONE if side == before else 2.0 * STAYS
        seen = Observation(Kind.END, np.array([2.1, 1.3]), STAYS + NEW, bend=Bend(STAYS, renewal, side))
        estimator.update({5: seen})
        before = side
    return estimator


def cov_of(estimator: Estimator) -> Array:
    """(2, 2) of the point."""
    return estimator.joint_covariance([5])[3:, 3:]
