"""EKF-SLAM with the right-invariant error on SE_{1+n}(2) (Barrau and Bonnabel, arXiv 1510.06263, 2015; TAC 2017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyr2

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import rotation_generator
from sixthsense.slam.estimators.ekf import EKF


class InvariantEKF(EKF):
    """The standard filter in coordinates in which a turn of the whole world is the same error at every estimate.

    With xi the right-invariant error, a position p has the error e_p = xi_p + xi_theta J p_hat in the world frame, and
    the heading e_theta = xi_theta: e = A(x_hat) xi. In xi the odometry's Jacobian is the identity and a sighting's does
    not depend on the estimate, so that no update gains information about the heading of the whole map. The covariance
    is kept in world coordinates: A P_xi A^T at the present estimate. The standard Jacobians at the present estimate are
    those of xi in these coordinates. Only the correction differs: it follows the group's exponential, and the
    covariance is transported to A at the corrected estimate.
    """

    def _apply_correction(self, slots: NDArray[np.int64], shift: Array) -> None:
        theta = float(shift[2])
        points = np.concatenate([[True], ~self._walls])
        before = np.vstack([self._pose.position, self._means])  # (1 + n, 2)
        step = np.vstack([shift[:2], shift[3:].reshape(-1, 2)])
        # xi = A^-1 shift, then x+ = exp(xi) x: turn by theta, translate by V(theta) xi_p (TAC 2017, eq. 15-17).
        xi = step - theta * rotation_generator(before)
        after = before @ rotation(theta).T + xi @ _left_jacobian(theta).T
        # A turn adds to a wall's angle and leaves its offset from the origin unchanged: for walls A is the identity.
        after[~points] = before[~points] + step[~points]
        after[~points, 0] = wrap_angle(after[~points, 0])
        self._pose = Pose(after[0, 0], after[0, 1], self._pose.theta + theta)
        self._means = after[1:]
        self._transport_covariance(np.where(points[:, None], rotation_generator(after - before), 0.0))

    def _transport_covariance(self, moved: Array) -> None:
        """Sigma = T Sigma T^T with T = A(x+) A(x-)^-1 = I + u e_theta^T, u the rows (1 + n, 2) of `moved`."""
        u = np.concatenate([moved[0], [0.0], moved[1:].ravel()])
        w = np.concatenate([self._cov[2, :2], self._cov[2:, 2]])  # Sigma's column of the heading
        w = w + 0.5 * w[2] * u
        self._cov = dsyr2(1.0, u, w, lower=1, a=self._cov, overwrite_a=1)


def _left_jacobian(theta: float) -> Array:
    """V (2, 2) of SE(2): exp(xi) translates by V xi_p."""
    half = 0.5 * theta
    return rotation(half) * np.sinc(half / np.pi)  # sin(half) / half
