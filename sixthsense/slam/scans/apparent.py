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
from sixthsense.slam.scans.links import FEW_RETURNS
from sixthsense.slam.scans.scan_store import Returns


def private_covariance(returns: Returns, key: int, sigma_m: float) -> Array:
    """(3, 3) of the private error of a scan's apparent pose, axes of its laser: H^-1 N H^-1.

    H is the Hessian of the distances of the scan's returns from their lines by the pose, less what the noise of the
    normals feigns, and N its gradient's covariance, where a range has the laser's noise `sigma_m`: across a wall that
    is as much of it as the beam meets the wall head-on. Along a direction that the scan does not observe the apparent
    pose says nothing, and there is no such error: what the odometry says there is in the graph.
    """
    x, y, ranges = returns.points[key].astype(np.float64).T
    nx, ny, variance = returns.normals[key].astype(np.float64).T
    has_line = (ranges > 0.0) & ((nx != 0.0) | (ny != 0.0))
    across = np.stack([nx, ny, x * ny - y * nx])[:, has_line]
    along = np.stack([-ny, nx, x * nx + y * ny])[:, has_line]
    cosine = along[2] / ranges[has_line]
    weights, axes = np.linalg.eigh(across @ across.T - (along * variance[has_line]) @ along.T)
    observed = weights > FEW_RETURNS
    inverse = (axes * np.where(observed, 1.0 / np.where(observed, weights, 1.0), 0.0)) @ axes.T
    return np.asarray(sigma_m**2 * inverse @ ((across * cosine**2) @ across.T) @ inverse)


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
