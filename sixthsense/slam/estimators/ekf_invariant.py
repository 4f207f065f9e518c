"""EKF-SLAM with the right-invariant error on SE_{1+n}(2) (Barrau and Bonnabel, arXiv 1510.06263, 2015; TAC 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyr2k

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import rotation_generator
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
        theta = float(shift[2])
        points = np.concatenate([[True], ~self._walls])
        before = np.vstack([self._pose.position, self._means])  # (1 + n, 2)
        step = np.vstack([shift[:2], shift[3:].reshape(-1, 2)])
        # xi = A^-1 shift, then x+ = exp(xi) x: turn by theta, translate by V(theta) xi_p (TAC 2017, eq. 15-17).
        xi = step - theta * rotation_generator(before)
        after = before @ rotation(theta).T + xi @ _left_jacobian(theta).T
        # A wall turns about its centre, and is shifted there.
        after[~points] = before[~points] + step[~points]
        after[~points, 0] = wrap_angle(after[~points, 0])
        self._pose = Pose(after[0, 0], after[0, 1], self._pose.theta + theta)
        self._means = after[1:]
        moved = np.where(points[:, None], rotation_generator(after - before), 0.0)
        self._transport_covariance(moved, _normals(after[~points, 0]) - _normals(before[~points, 0]), before[0])

    def _transport_covariance(self, moved: Array, turned: Array, position: Array) -> None:
        """Sigma = T Sigma T^T with T = A(x+) A(x-)^-1 = I + u e_theta^T + B (e_p - e_theta J p)^T.

        u holds the rows (1 + n, 2) of `moved`, and b^T J c in the row of a wall's offset, with the change b of its
        normal and its centre c; B the changes (w, 2), `turned`, in the same rows; p is the robot's `position` (2,)
        before the correction.
        """
        U = np.zeros((self._size, 3))
        U[:, 0] = np.concatenate([moved[0], np.zeros(self._head - 2), moved[1:].ravel()])
        offsets = self._head + 1 + 2 * np.flatnonzero(self._walls)
        U[offsets, 0] = (turned * rotation_generator(self._centres[self._walls])).sum(axis=1)
        U[offsets, 1:] = turned
        of_pose = np.vstack([self._symmetric(np.arange(3)), self._cov[3:, :3]])  # Sigma's columns of the pose
        C = np.zeros((3, 3))  # theta and xi_p from the errors of the pose
        C[0, 2] = C[1, 0] = C[2, 1] = 1.0
        C[1:, 2] = -rotation_generator(position)
        W = of_pose @ C.T + 0.5 * U @ (C @ of_pose[:3] @ C.T)
        self._cov = dsyr2k(1.0, U, W, beta=1.0, c=self._cov, lower=1, overwrite_c=1)


def _normals(alpha: Array) -> Array:
    """(w, 2) normals of walls with the angles `alpha` (w,)."""
    return np.column_stack([np.cos(alpha), np.sin(alpha)])


def _left_jacobian(theta: float) -> Array:
    """V (2, 2) of SE(2): exp(xi) translates by V xi_p."""
    half = 0.5 * theta
    return rotation(half) * np.sinc(half / np.pi)  # sin(half) / half
