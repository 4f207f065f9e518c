"""Variants of EKF-SLAM that stay consistent: with the right-invariant error, and with Jacobians at other points."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import rotation_generator
from sixthsense.slam.estimators.base import Estimate
from sixthsense.slam.estimators.ekf import EKF


class InvariantEKF(EKF):
    """The standard filter in coordinates in which a motion of the whole world is the same error at every estimate.

    With xi the right-invariant error, a position p has the error e_p = xi_p + xi_theta J p_hat in the world frame, the
    heading e_theta = xi_theta, and the offset of a wall with the normal n from its centre c the error e_d = xi_d +
    n_hat^T (xi_p + xi_theta J c), with the xi_p of the robot: e = A(x_hat) xi. In xi the odometry's Jacobian is the
    identity, and an observation's depends neither on xi_theta nor, of a wall, on xi_p, so that no update gains
    information about the pose of the whole map. The covariance is kept in world coordinates: A P_xi A^T at the present
    estimate. The standard Jacobians at the present estimate are those of xi in these coordinates. Only the correction
    differs: it follows the group's exponential, and the covariance is transported to A at the corrected estimate.
    """

    _has_centres = True

    def _apply_correction(self, slots: NDArray[np.int64], shift: Array) -> None:
        x, y, theta = self._pose.triple()
        moved, U = _corrected(np.vstack([[x, y], self._means]), self._walls, self._centres, shift, self._head)
        self._pose = Pose(float(moved[0, 0]), float(moved[0, 1]), theta + float(shift[2]))
        self._means = moved[1:]
        # Sigma = T Sigma T^T with T = A(x+) A(x-)^-1 = I + U C, where C takes theta and the xi_p of the robot.
        C = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, y], [0.0, 1.0, -x]])
        cross = C @ self._cov[:3]
        half = U @ (cross + 0.5 * (cross[:, :3] @ C.T) @ U.T)
        self._cov += half + half.T


def _corrected(places: Array, walls: NDArray[np.bool_], centres: Array, shift: Array, head: int) -> tuple[Array, Array]:
    """The robot's position and the means of landmarks after a correction by `shift` (3 + 2n,), and U (head + 2n, 3).

    `places` (1 + n, 2) are these before it. xi = A^-1 shift, then x+ = exp(xi) x: turn by theta, translate by V(theta)
    xi_p (TAC 2017, eq. 15-17). A wall turns about its centre, and is shifted there. The first column of U holds what a
    turn by theta adds to the error of a moved position, and b^T J c in the row of a wall's offset, with the change b of
    its normal and its centre c; the others hold b there.
    """
    theta, added = float(shift[2]), np.delete(shift, 2).reshape(-1, 2)
    V = np.sinc(0.5 * theta / np.pi) * rotation(0.5 * theta)
    moved = places @ rotation(theta).T + (added - theta * rotation_generator(places)) @ V.T
    U, turned = np.zeros((head + 2 * len(walls), 3)), rotation_generator(moved - places)
    rows, lines = U[head:].reshape(-1, 2, 3), places[1:][walls] + added[1:][walls]
    U[:2, 0], rows[:, :, 0] = turned[0], turned[1:]
    b = _normals(lines[:, 0]) - _normals(places[1:][walls, 0])
    rows[walls, 0, 0], rows[walls, 1, 0], rows[walls, 1, 1:] = 0.0, (b * rotation_generator(centres[walls])).sum(1), b
    moved[1:][walls] = np.column_stack([wrap_angle(lines[:, 0]), lines[:, 1]])
    return moved, U


def _normals(angles: Array) -> Array:
    return np.column_stack([np.cos(angles), np.sin(angles)])


class AnchoredEKF(EKF):
    """An EKF whose Jacobians are taken at points that keep all three unobservable directions of SLAM.

    A turn of the whole world is unobservable if each Jacobian has the same null vector: `rotation_generator` of the
    robot's linearization point, which moves with the robot; 1; and `rotation_generator` of each landmark's anchor,
    which never moves. So the levers are anchors less that point (Huang et al. 2010, eq. 20-23). The variants choose
    the point: by how much it moves towards the estimate with the robot's first motion after a correction.

    The filter's covariance is that of errors about these points: the effect of a heading error on a position is taken
    there. `estimate` and `joint_covariance` transport it to errors about the estimates, which have moved on since.
    """

    _has_centres = True

    def __init__(self, start: Pose, start_cov: Array) -> None:
        super().__init__(start, start_cov)
        self._point = np.zeros(2)
        """(2,) the robot's linearization point"""
        self._shift = np.zeros(2)
        """(2,) added to the robot's next displacement, to give that of the linearization point"""

    def _shift_after(self, slots: NDArray[np.int64]) -> Array:
        """(2,) of a correction by the landmarks in `slots`."""
        raise NotImplementedError

    def _heading_lever(self, moved: Array) -> Array:
        lever, self._shift = moved + self._shift, np.zeros(2)
        self._point = self._point + lever
        return np.asarray(lever)

    def _apply_correction(self, slots: NDArray[np.int64], shift: Array) -> None:
        super()._apply_correction(slots, shift)
        self._shift = self._shift_after(slots)

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

    def _shift_after(self, slots: NDArray[np.int64]) -> Array:
        # From prediction to prediction (Huang et al. 2008, eq. 26); the standard filter starts at the corrected pose.
        return self._pose.position - self._point


class ObservabilityConstrainedEKF(AnchoredEKF):
    """The linearization point follows the newest estimates as closely as the observability constraint allows.

    Of all points that keep the null vector the filter takes those nearest to the estimates, in least squares over the
    robot's displacement and the levers of its observations (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010,
    section 5.2: for one landmark, half of the gap between anchor and estimate goes to each). The landmarks of the last
    update are used in place of those of the next, so that the point is known when the robot moves.
    """

    def _shift_after(self, slots: NDArray[np.int64]) -> Array:
        walls = self._walls[slots]
        point, anchors = self._linearization_points(slots)
        lag = self._pose.position - point
        gaps = (anchors - self._means[slots])[~walls] + lag  # (m, 2)
        alpha = anchors[walls, 0]
        along = np.column_stack([-np.sin(alpha), np.cos(alpha)])
        # argmin of |shift|^2 + sum over points |gap - shift|^2 + sum over walls (along . (lag - shift))^2: for a wall,
        # d offset / d angle depends on the robot's position along it.
        spread = along.T @ along
        return np.linalg.solve((1 + len(gaps)) * np.eye(2) + spread, gaps.sum(axis=0) + spread @ lag)
