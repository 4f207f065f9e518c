"""EKF-SLAM with the right-invariant error, which stays consistent (Barrau and Bonnabel, TAC 62(4), 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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

    def _apply_correction(self, shift: Array) -> None:
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
