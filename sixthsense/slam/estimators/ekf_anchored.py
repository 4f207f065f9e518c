"""EKF-SLAM whose Jacobians keep the observability of SLAM (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import rotation_generator
from sixthsense.slam.estimators.base import Estimate
from sixthsense.slam.estimators.ekf import EKF


class AnchoredEKF(EKF):
    """An EKF whose Jacobians are taken at points that keep all three unobservable directions of SLAM.

    A turn of the whole world is unobservable if each Jacobian has the same null vector: `rotation_generator` of the
    robot's linearization point, which moves with the robot; 1; and `rotation_generator` of each landmark's anchor,
    which never moves. So the levers are anchors less that point (Huang et al. 2010, eq. 20-23). The variants choose
    the point.

    The filter's covariance is that of errors about these points: the effect of a heading error on a position is taken
    there. `estimate` and `joint_covariance` transport it to errors about the estimates, which have moved on since.
    """

    _has_centres = True

    def __init__(self, start: Pose, start_cov: Array) -> None:
        super().__init__(start, start_cov)
        self._point = np.zeros(2)
        """(2,) the robot's linearization point"""

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        return dataclasses.replace(super().estimate(), pose_cov=self.joint_covariance([]))

    def _about_estimates(self, joint: Array, slots: NDArray[np.int64]) -> Array:
        robot = rotation_generator(self._pose.position - self._point)
        landmarks = self._turned(self._means[slots], slots) - self._turned(self._anchors[slots], slots)
        u = np.concatenate([robot, [0.0], landmarks.ravel()])
        # T joint T^T with T = I + u e_theta^T: from the null vector at the points to that at the estimates
        half = np.outer(u, joint[:, 2] + 0.5 * joint[2, 2] * u)
        return np.asarray(joint + (half + half.T))

    def _turned(self, landmarks: Array, slots: NDArray[np.int64]) -> Array:
        """(k, 2) the change of landmarks in `slots` by a turn of the world: a wall's centre stays where it is."""
        walls, centres = self._walls[slots], self._centres[slots]
        change = rotation_generator(landmarks, walls)
        alpha = landmarks[walls, 0]
        change[walls, 1] = np.sin(alpha) * centres[walls, 0] - np.cos(alpha) * centres[walls, 1]
        return change

    def _linearization_points(self, slots: NDArray[np.int64]) -> tuple[Array, Array]:
        return self._point, self._anchors[slots]


class FirstEstimatesEKF(AnchoredEKF):
    """The robot's linearization point is its predicted position, which later corrections do not change (ICRA 2008)."""

    def _heading_lever(self, moved: Array) -> Array:
        # From prediction to prediction (Huang et al. 2008, eq. 26); the standard filter starts at the corrected pose.
        lever = self._pose.position + moved - self._point
        self._point = self._point + lever
        return np.asarray(lever)


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
