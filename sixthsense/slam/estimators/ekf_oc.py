"""EKF-SLAM whose linearization points are the best that keep the system's observability (OC-EKF)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.ekf_fej import AnchoredEKF


class ObservabilityConstrainedEKF(AnchoredEKF):
    """The linearization point follows the newest estimates as closely as the observability constraint allows.

    Of all points that keep the null vector the filter takes those nearest to the estimates, in least squares over the
    robot's displacement and the levers of its observations (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010,
    section 5.2: for one landmark, half of the gap between anchor and estimate goes to each). The landmarks of the last
    update are used in place of those of the next, so that the point is known when the robot moves.
    """

    def __init__(self, start: Pose, start_cov: Array) -> None:
        super().__init__(start, start_cov)
        self._shift = np.zeros(2)
        """(2,) added to the robot's next displacement, to give that of the linearization point"""

    def _heading_lever(self, moved: Array) -> Array:
        lever = moved + self._shift
        self._point = self._point + lever
        self._shift = np.zeros(2)
        return np.asarray(lever)

    def _apply_correction(self, slots: NDArray[np.int64], shift: Array) -> None:
        super()._apply_correction(slots, shift)
        walls = self._walls[slots]
        point, anchors = self._linearization_points(slots)
        lag = self._pose.position - point
        gaps = (anchors - self._means[slots])[~walls] + lag  # (m, 2)
        alpha = anchors[walls, 0]
        along = np.column_stack([-np.sin(alpha), np.cos(alpha)])
        # argmin of |shift|^2 + sum over points |gap - shift|^2 + sum over walls (along . (lag - shift))^2: for a wall,
        # d offset / d angle depends on the robot's position along it.
        spread = along.T @ along
        self._shift = np.linalg.solve((1 + len(gaps)) * np.eye(2) + spread, gaps.sum(axis=0) + spread @ lag)
