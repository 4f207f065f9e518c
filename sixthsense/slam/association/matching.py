"""Innovations of observations against landmarks, and the likeliest one-to-one assignment (report section 4.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import LandmarkId, Observation, observation_innovations, predict, stacked_jacobian
from sixthsense.slam.association.pre_gate import Mask, PreGate
from sixthsense.slam.estimators.base import Estimate, Estimator

Indices = NDArray[np.int64]

_LEAST_COVERED = 0.5
"""of what the wall covers that covers most of an observation"""


@dataclass(frozen=True, slots=True)
class Innovations:
    """Innovations of m observations against k landmarks, for all pairs."""

    values: Array
    """(m, k, 2)"""
    noise: Array
    """(m, k, 2, 2) covariances of the observations about the predictions"""
    squared: Array
    """(m, k) squared Mahalanobis distance, infinite where the pair is not plausible"""
    log_det: Array
    """(m, k) logarithm of the determinant of the innovation's covariance"""
    by_pose: Array
    """(k, 2, 3) Jacobian of the predicted observation by the pose"""
    by_landmark: Array
    """(k, 2, 2) Jacobian of the predicted observation by the landmark"""
    predicted: Array
    """(k, 2) predicted observations"""
    walls: Mask
    """(k,) which of the landmarks are walls"""


def compare(
    observations: Sequence[Observation],
    estimate: Estimate,
    near: Indices,
    joint: Array,
    plausible: Mask,
    noise: Array | None = None,
) -> Innovations:
    """Innovations of all observations against the landmarks at `near` (k,), whose covariance with the pose is `joint`.

    `noise` (m, k, 2, 2) of the observations where it is not the same for all landmarks.
    """
    walls = estimate.walls[near]
    predicted, by_pose, by_landmark = predict(estimate.pose, estimate.landmarks[near], walls)
    z = np.array([s.z for s in observations])
    if noise is None:
        noise = np.array([s.cov for s in observations])[:, None]
    values, noise = observation_innovations(z[:, None, :], noise, predicted[None, :, :], walls[None, :])
    S = predicted_covs(joint, by_pose, by_landmark)[None] + noise  # (m, k, 2, 2)
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    a, b = values[..., 0], values[..., 1]
    squared = (a * a * S[..., 1, 1] - 2 * a * b * S[..., 0, 1] + b * b * S[..., 0, 0]) / det
    squared = np.where(plausible, squared, np.inf)
    return Innovations(values, noise, squared, np.log(det), by_pose, by_landmark, predicted, walls)


def compare_known(
    observations: Mapping[LandmarkId, Observation], known: list[LandmarkId], estimate: Estimate, estimator: Estimator
) -> tuple[Innovations, Array]:
    """Innovations of the observations of landmarks that are known, each of its own one, and the joint covariance."""
    order = {i: k for k, i in enumerate(estimate.ids.tolist())}
    near, seen = np.array([order[i] for i in known]), [observations[i] for i in known]
    joint = estimator.joint_covariance(known)
    return compare(seen, estimate, near, joint, np.eye(len(known), dtype=np.bool_)), joint


def without_barely_covered(innovation: Innovations, fits: PreGate, near: Indices, gate: float) -> Innovations:
    """The innovations, infinite for walls that cover much less of an observation than another one inside the gate.

    Two walls that meet at a small angle are one beside the other where they meet. A short piece of the one passes the
    gate of both, though it lies beyond what is known of the other.
    """
    most = np.where(innovation.squared < gate, fits.covered[:, near], 0.0).max(axis=1, initial=0.0)
    barely = fits.coverable[:, near] < _LEAST_COVERED * most[:, None]
    return replace(innovation, squared=np.where(barely, np.inf, innovation.squared))


def assign(innovation: Innovations, gate: float) -> tuple[Indices, Indices]:
    """The likeliest one-to-one matches inside the gate: rows (observations) and columns (landmarks)."""
    return assigned(innovation.squared, innovation.log_det, gate)


def assigned(squared: Array, log_det: Array, gate: float) -> tuple[Indices, Indices]:
    """As `assign`, from squared innovations (m, k) and the logarithms of the determinants of their covariances."""
    inside = squared < gate
    # The log-likelihood, since the distance alone would favour a landmark with a large covariance.
    cost = np.where(inside, squared + log_det, 1e6)
    from scipy.optimize import linear_sum_assignment  # here, since it takes half a second to load

    rows, cols = linear_sum_assignment(cost)
    paired = inside[rows, cols]
    return rows[paired], cols[paired]


def predicted_covs(joint: Array, by_pose: Array, by_landmark: Array) -> Array:
    """(k, 2, 2): H Sigma H^T of each landmark's observation, from the joint covariance of pose and landmarks."""
    k = len(by_pose)
    own = joint[3:, 3:].reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :]
    cross = joint[:3, 3:].reshape(3, k, 2).transpose(1, 0, 2)  # (k, 3, 2)
    transposed = by_landmark.transpose(0, 2, 1)
    mixed = by_pose @ cross @ transposed
    pose_part = by_pose @ joint[:3, :3] @ by_pose.transpose(0, 2, 1)
    return np.asarray(pose_part + mixed + mixed.transpose(0, 2, 1) + by_landmark @ own @ transposed)


def joint_nis(joint: Array, by_pose: Array, by_landmark: Array, innovation: Array, noise: Array) -> float:
    """Normalised innovation squared of m matches, with the correlations between them.

    `joint` (3 + 2m, 3 + 2m) in the order of the matches, all else (m, ...).
    """
    if len(by_pose) == 0:
        return 0.0
    H = stacked_jacobian(by_pose, by_landmark)
    S = H @ joint @ H.T + block_diagonal(noise)
    stacked = innovation.ravel()
    return float(stacked @ np.linalg.solve(S, stacked))


def matches_nis(innovation: Innovations, matched: Sequence[Observation], cols: Indices, joint: Array) -> float:
    """Normalised innovation squared of all matches together, with the correlations between them."""
    index = np.concatenate([np.arange(3), (3 + 2 * cols[:, None] + np.arange(2)).ravel()])
    if not len(matched):
        return 0.0
    z, cov = np.array([s.z for s in matched]), np.array([s.cov for s in matched])
    values, noise = observation_innovations(z, cov, innovation.predicted[cols], innovation.walls[cols])
    by_pose, by_landmark = innovation.by_pose[cols], innovation.by_landmark[cols]
    return joint_nis(joint[np.ix_(index, index)], by_pose, by_landmark, values, noise)


def block_diagonal(blocks: Array) -> Array:
    """(2n, 2n) the (n, 2, 2) blocks along the diagonal; faster than scipy's for blocks of any shape."""
    n = len(blocks)
    matrix = np.zeros((n, 2, n, 2))
    matrix[np.arange(n), :, np.arange(n), :] = blocks
    return matrix.reshape(2 * n, 2 * n)
