"""Observability of the filters: the information gained about the unobservable position and rotation of the world.

SLAM has three unobservable directions, the rigid motions of the world. All quantities are computed from covariances
before and after each step: Phi from the covariance of pose and landmarks, H^T R^-1 H as the information added by an
update. Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, Observation, rotation_generator
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.testing.batch import to_robot
from sixthsense.testing.estimators import joint_state, make

_POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])
_START, _START_COV = Pose(0.3, -0.2, 0.4), np.diag([0.02, 0.03, 0.01]) + 0.002
_MOTION = Pose(0.2, 0.0, 0.1)


def _drive(
    rng: np.random.Generator, sigma: float, steps: int, seen: int, point_sigma: float, noise: bool = True
) -> Iterator[tuple[Odometry, dict[int, Observation]]]:
    """Motions with standard deviations `sigma`, m, and half of it, rad, and observations of `seen` points."""
    true, cov = _START, np.diag([sigma, sigma, 0.5 * sigma]) ** 2
    for _ in range(steps):
        drawn = np.sqrt(np.diag(cov)) * rng.standard_normal(3) if noise else np.zeros(3)
        true = true @ Pose.from_array(_MOTION.array() + drawn)
        yield Odometry(_MOTION, cov), _sight(true, rng.permutation(5)[:seen].tolist(), rng, point_sigma, noise)


def _sight(
    pose: Pose, ids: Iterable[int], rng: np.random.Generator, sigma: float, noise: bool = True
) -> dict[int, Observation]:
    """Observations of points from a pose, with noise `sigma`, m, or none."""
    errors = {i: sigma * rng.standard_normal(2) if noise else np.zeros(2) for i in ids}
    z = {i: to_robot(pose.array(), _POINTS[i], False) + error for i, error in errors.items()}
    return {i: Observation(Kind.CORNER, z[i], sigma**2 * np.eye(2)) for i in z}


def coordinates(name: str, estimate: Estimate) -> Array:
    """A (n, n): the errors in world coordinates are A times the errors in which the filter is linear.

    The latter are the invariant errors xi for the consistent filter.
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
    estimator = make(name, _START, _START_COV)
    estimator.update(_sight(_START, range(5), rng, 0.05, noise))
    updated = own_covariance(name, estimator)
    transition, gramian = np.eye(len(updated)), np.zeros_like(updated)
    for odometry, observations in _drive(rng, 0.05, 12, 5, 0.05, noise):
        estimator.predict(odometry)
        predicted = own_covariance(name, estimator)
        phi = np.eye(len(updated))  # for xi, whose landmark part changes only by the odometry noise
        if name == "ekf":  # Sigma_lp' = Sigma_lp Phi^T
            phi[:3, :3] = np.linalg.lstsq(updated[3:, :3], predicted[3:, :3])[0].T
        estimator.update(observations)
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
    estimator, variances = make(name, _START, _START_COV, ISAM2Config()), []
    for odometry, observations in _drive(np.random.default_rng(seed), 0.04, 150, 3, 0.1):
        estimator.predict(odometry)
        estimator.update(observations)
        variances.append(estimator.estimate().pose_cov[2, 2])
    return np.asarray(np.array(variances) / _START_COV[2, 2])
