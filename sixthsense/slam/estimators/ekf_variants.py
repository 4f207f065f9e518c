"""Variants of EKF-SLAM that stay consistent: with the right-invariant error, and with Jacobians at other points."""

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyr2k

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import rotation_generator
from sixthsense.core.se2 import wrapped
from sixthsense.slam.estimators.base import Estimate
from sixthsense.slam.estimators.ekf import EKF

Place = tuple[float, float]


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
        before = self._pose.x, self._pose.y
        (x, y), means, U = _corrected(before, self._means, self._walls, self._centres, shift, self._head)
        self._pose, self._means = Pose(x, y, self._pose.theta + float(shift[2])), means
        # Sigma = T Sigma T^T with T = A(x+) A(x-)^-1 = I + U C.
        W = _transported(self._cov.T, before, U)
        self._cov = dsyr2k(1.0, U.T, W.T, trans=1, beta=1.0, c=self._cov, lower=1, overwrite_c=1)


@numba.njit(cache=True, error_model="numpy")
def _corrected(
    position: tuple[float, float],
    means: Array,
    walls: NDArray[np.bool_],
    centres: Array,
    shift: Array,
    head: int,
) -> tuple[tuple[float, float], Array, Array]:
    """The robot's position and the means (n, 2) after a correction by `shift` (3 + 2n,), and U (head + 2n, 3).

    xi = A^-1 shift, then x+ = exp(xi) x: turn by theta, translate by V(theta) xi_p (TAC 2017, eq. 15-17). A wall turns
    about its centre, and is shifted there. The first column of U holds what a turn by theta adds to the error of a
    moved position, and b^T J c in the row of a wall's offset, with the change b of its normal and its centre c; the
    others hold b there.
    """
    theta = shift[2]
    c, s = math.cos(theta), math.sin(theta)
    along, aside = _left_jacobian(theta)
    U, moved = np.zeros((head + 2 * len(means), 3)), np.empty(means.shape)
    x, y = position
    xi, eta = shift[0] + theta * y, shift[1] - theta * x
    new = c * x - s * y + along * xi - aside * eta, s * x + c * y + aside * xi + along * eta
    U[0, 0], U[1, 0] = y - new[1], new[0] - x
    for k in range(len(means)):
        a, b = means[k, 0], means[k, 1]
        da, db = shift[3 + 2 * k], shift[4 + 2 * k]
        row = head + 2 * k
        if walls[k]:
            alpha = wrapped(a + da)
            moved[k, 0], moved[k, 1] = alpha, b + db
            nx, ny = math.cos(alpha) - math.cos(a), math.sin(alpha) - math.sin(a)
            U[row + 1, 0], U[row + 1, 1], U[row + 1, 2] = ny * centres[k, 0] - nx * centres[k, 1], nx, ny
        else:
            xi, eta = da + theta * b, db - theta * a
            moved[k, 0] = c * a - s * b + along * xi - aside * eta
            moved[k, 1] = s * a + c * b + aside * xi + along * eta
            U[row, 0], U[row + 1, 0] = b - moved[k, 1], moved[k, 0] - a
    return new, moved, U


@numba.njit(cache=True, error_model="numpy")
def _left_jacobian(theta: float) -> tuple[float, float]:
    """The first column of V (2, 2) of SE(2), a rotation times a factor: exp(xi) translates by V xi_p."""
    half = 0.5 * theta
    factor = math.sin(half) / half if half != 0.0 else 1.0
    return factor * math.cos(half), factor * math.sin(half)


@numba.njit(cache=True, error_model="numpy")
def _transported(upper: Array, position: Place, U: Array) -> Array:
    """W (n, 3) with Sigma + U W^T + W U^T = T Sigma T^T, where T = I + U C; `upper` (n, n) is Sigma's transpose.

    C takes theta and the xi_p of the robot at a position from the errors of its pose.
    """
    x, y = position
    W, own = np.empty(U.shape), np.empty((3, 3))
    for i in range(len(U)):
        ex, ey, theta = upper[0, i], upper[min(i, 1), max(i, 1)], upper[min(i, 2), max(i, 2)]
        W[i, 0], W[i, 1], W[i, 2] = theta, ex + y * theta, ey - x * theta
    for k in range(3):  # C Sigma C^T
        own[0, k], own[1, k], own[2, k] = W[2, k], W[0, k] + y * W[2, k], W[1, k] - x * W[2, k]
    for i in range(len(U)):
        for k in range(3):
            W[i, k] += 0.5 * (U[i, 0] * own[0, k] + U[i, 1] * own[1, k] + U[i, 2] * own[2, k])
    return W


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
