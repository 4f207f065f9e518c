"""Observability of the filters: the information gained about the unobservable position and rotation of the world.

SLAM has three unobservable directions, the rigid motions of the world. All quantities are computed from covariances
before and after each step: Phi from the covariance of pose and landmarks, H^T R^-1 H as the information added by an
update. Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010.
"""

from __future__ import annotations

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import rotation_generator
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.testing.estimation import (
    START,
    START_COV,
    joint_state,
    make,
    noisy,
    sight,
    sight_exactly,
    step,
)


def coordinates(name: str, estimate: Estimate) -> Array:
    """A (n, n): the errors in world coordinates are A times the errors in which the filter is linear.

    The latter are the invariant errors xi for the consistent filters: for ekf-invariant by design, for the others
    because the covariance kept about the points of linearisation is returned about the estimates.
    """
    size = 3 + 2 * len(estimate.ids)
    A = np.eye(size)
    if name != "ekf":
        rest = [i for i in range(size) if i != 2]
        A[rest, 2] = rotation_generator(np.vstack([estimate.pose.position, estimate.landmarks])).ravel()
    return A


def own_covariance(name: str, estimator: Estimator) -> Array:
    """(n, n) joint covariance in the coordinates in which the filter is linear."""
    estimate, joint = joint_state(estimator)
    back = np.linalg.inv(coordinates(name, estimate))
    return np.asarray(back @ joint @ back.T)


def observability_gramian(name: str, seed: int, noise: bool) -> Array:
    """Sum over a window of Phi(k, 0)^T H_k^T R_k^-1 H_k Phi(k, 0), in the coordinates of the filter."""
    rng = np.random.default_rng(seed)
    estimator, true = make(name), START
    estimator.update(sight(true, range(5), rng) if noise else sight_exactly(name, true, range(5)))
    updated = own_covariance(name, estimator)
    transition, gramian = np.eye(len(updated)), np.zeros_like(updated)
    for _ in range(12):
        odometry = step(sigma=0.05)
        true = true @ (noisy(odometry, rng) if noise else odometry.motion)
        estimator.predict(odometry)
        predicted = own_covariance(name, estimator)
        phi = np.eye(len(updated))  # for xi, whose landmark part changes only by the odometry noise
        if name == "ekf":  # Sigma_lp' = Sigma_lp Phi^T
            phi[:3, :3] = np.linalg.lstsq(updated[3:, :3], predicted[3:, :3])[0].T
        estimator.update(sight(true, range(5), rng) if noise else sight_exactly(name, true, range(5)))
        updated = own_covariance(name, estimator)
        transition = phi @ transition
        gramian += transition.T @ (np.linalg.inv(updated) - np.linalg.inv(predicted)) @ transition
    return np.asarray(gramian)


def nullity(gramian: Array) -> int:
    """Number of unobserved directions; their eigenvalues are 1e-15 of the largest by rounding, 1e-5 with false gain."""
    eigenvalues = np.linalg.eigvalsh(gramian)
    return int(np.sum(np.abs(eigenvalues) < 1e-9 * eigenvalues[-1]))


def heading_variances(name: str, seed: int) -> Array:
    """(150,) heading variance over several loops, relative to the start; no measurement can lower it."""
    rng = np.random.default_rng(seed)
    estimator, true, variances = make(name, isam2=ISAM2Config()), START, []
    for _ in range(150):
        odometry = step(sigma=0.04)
        true = true @ noisy(odometry, rng)
        estimator.predict(odometry)
        estimator.update(sight(true, rng.choice(5, 3, replace=False).tolist(), rng, 0.1))
        variances.append(estimator.estimate().pose_cov[2, 2])
    return np.asarray(np.array(variances) / START_COV[2, 2])
