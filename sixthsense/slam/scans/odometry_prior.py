"""What the odometry since the last keyframe says of a scan's pose."""

from __future__ import annotations

import numba
import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import turned_covariance
from sixthsense.slam.scans.alignment import Prior
from sixthsense.slam.scans.tracking import SLIP_SIGMAS


def weakened(odometry: Odometry, slip: float) -> Odometry:
    """Odometry that the scans have contradicted by the squared Mahalanobis distance `slip`."""
    return Odometry(odometry.motion, odometry.cov * (1.0 + slip / SLIP_SIGMAS**2), odometry.wheels)


def prior_of(key_pose: Array, odometry: Odometry) -> Prior:
    """The prior of a pose, from that of the last keyframe (3,), world frame, and the odometry since then."""
    pose = Pose.from_array(key_pose)
    information = informations_in_world(key_pose[None], odometry.cov[None])[0]
    return Prior((pose @ odometry.motion).array(), information, SLIP_SIGMAS)


def informations_in_world(key_poses: Array, covs: Array) -> Array:
    """(m, 3, 3) informations, world axes, of motions with covariances (m, 3, 3), axes of the key poses (m, 3)."""
    return np.asarray(_informations(np.ascontiguousarray(key_poses), covs))


@numba.njit(cache=True, error_model="numpy")
def _informations(key_poses: Array, covs: Array) -> Array:
    out = np.empty((len(covs), 3, 3))
    for k in range(len(covs)):
        a = turned_covariance(covs[k], key_poses[k, 2])
        # By its cofactors: for matrices of this size a call of LAPACK takes longer.
        xx, xy = a[1, 1] * a[2, 2] - a[1, 2] ** 2, a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
        xt = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
        yy, yt = a[0, 0] * a[2, 2] - a[0, 2] ** 2, a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
        tt = a[0, 0] * a[1, 1] - a[0, 1] ** 2
        per_determinant = 1.0 / (a[0, 0] * xx + a[0, 1] * xy + a[0, 2] * xt)
        out[k, 0, 0], out[k, 0, 1], out[k, 0, 2] = xx, xy, xt
        out[k, 1, 0], out[k, 1, 1], out[k, 1, 2] = xy, yy, yt
        out[k, 2, 0], out[k, 2, 1], out[k, 2, 2] = xt, yt, tt
        out[k] *= per_determinant
    return out
