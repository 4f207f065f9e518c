"""Apparent poses: a link measures between what two scans seem to be seen from, each with an error of its own.

A scan takes part in many links, and its returns have the same errors in all of them. The graph therefore holds apparent
poses, each the true pose and one private error of its scan. That error does not average out over links. It is added to
the covariance of a pose that is reported, and so is that of the first pose, which the world's frame is fixed to.
Mourikis and Roumeliotis, "Analysis of Positioning Uncertainty in Simultaneous Localization and Mapping (SLAM)",
IROS 2004, treat the same correlation for relative-pose measurements.
"""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.alignment import HESSIAN, SPREAD, SUMS, SURFACE_M, Loss, add_one_way, matrix
from sixthsense.slam.scans.links import FEW_RETURNS
from sixthsense.slam.scans.scan_store import Returns

_OWN_LOSS = Loss(SURFACE_M, 1.0)


def private_covariance(returns: Returns, key: int, sigma_m: float) -> Array:
    """(3, 3) of the private error of a scan's apparent pose, axes of its laser: 2 sigma^2 H^-1.

    H is the Hessian of the scan's returns on their own lines, and `sigma_m` the laser's. The factor is that of a
    return's noise and of the line's that it is compared with. Along a direction that the scan does not observe the
    apparent pose says nothing, and there is no such error: what the odometry says there is in the graph.
    """
    sums = np.zeros(SUMS)
    add_one_way(returns, key, key, np.zeros(3), _OWN_LOSS, sums)
    weights, axes = np.linalg.eigh(returns.bearings.stride * (matrix(sums, HESSIAN) - matrix(sums, SPREAD)))
    observed = weights > FEW_RETURNS
    variances = np.where(observed, 2.0 * sigma_m**2 / np.where(observed, weights, 1.0), 0.0)
    return np.asarray((axes * variances) @ axes.T)


def reported(cov: Array, pose: Array, own: Array, first: Array, start: Array) -> Array:
    """(3, 3) covariance of a true pose (3,) from that of its apparent pose, world axes.

    `own` and `first` (3, 3) are the private covariances of its scan and of the first one, which was seen from `start`
    (3,), both in the axes of their lasers. The error of the first turns and shifts all that follows.
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = np.cos(start[2]), np.sin(start[2])
    x, y = pose[:2] - start[:2]
    moved = np.array([[c, -s, -y], [s, c, x], [0.0, 0.0, 1.0]])
    return np.asarray(cov + turn @ own @ turn.T + moved @ first @ moved.T)
