"""EKF-SLAM whose points of linearisation are the best that keep the system's observability (OC-EKF)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.ekf_fej import AnchoredEKF


class ObservabilityConstrainedEKF(AnchoredEKF):
    """The point of linearisation follows the newest estimates as closely as the constraint lets it.

    Of all points that keep the null vector the filter takes those nearest to the estimates, in least squares, for the
    way of the robot and the levers of its sightings together (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010,
    section 5.2: for one landmark, the gap between anchor and estimate is shared half and half). Here the landmarks of
    the last update stand for those of the next, so that the point is known when the robot moves.
    """

    def __init__(self, start: Pose, start_cov: Array) -> None:
        super().__init__(start, start_cov)
        self._pull = np.zeros(2)
        """(2,) by which the next way shall differ from the one the robot made"""

    def _on_moved(self, moved: Array) -> Array:
        way = moved + self._pull
        self._point = self._point + way
        self._pull = np.zeros(2)
        return np.asarray(way)

    def _on_seen(self, slots: NDArray[np.int64], shift: Array) -> None:
        super()._on_seen(slots, shift)
        walls = self._walls[slots]
        point, anchors = self._linearised_at(slots)
        lag = self._pose.position - point
        gaps = (anchors - self._means[slots])[~walls] + lag  # (m, 2)
        alpha = anchors[walls, 0]
        along = np.column_stack([-np.sin(alpha), np.cos(alpha)])
        # argmin of |pull|^2 + sum over points |gap - pull|^2 + sum over walls (along . (lag - pull))^2: how a wall's
        # offset follows its angle depends on where along it the robot is.
        spread = along.T @ along
        self._pull = np.linalg.solve((1 + len(gaps)) * np.eye(2) + spread, gaps.sum(axis=0) + spread @ lag)
