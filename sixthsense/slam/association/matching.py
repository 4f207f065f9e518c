"""Innovations of observations against landmarks (report section 4.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation, observation_innovations, predict, stacked_jacobian
from sixthsense.slam.association.joint_assignment import Indices, Pairs
from sixthsense.slam.association.observed import Mask, Observed
from sixthsense.slam.estimators.base import Belief, Estimate


@dataclass(frozen=True, slots=True)
class Innovations:
    """Innovations of m observations against k landmarks, for all pairs."""

    pairs: Pairs
    """with their covariances"""
    squared: Array
    """(m, k) squared Mahalanobis distance"""
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

    def pose_given(self, pose: Pose, joint: Array, matched: Indices) -> Pose:
        """The predicted `pose` updated with matches (m,), -1: none; `joint` as of `compare`."""
        rows = np.flatnonzero(matched >= 0)
        cols = matched[rows]
        index = (2 * cols[:, None] + np.arange(2)).ravel()
        S = self.pairs.predicted[np.ix_(index, index)] + block_diagonal(self.pairs.noise[rows, cols])
        by_landmark = self.by_landmark[cols]
        cross = joint[:3, 3:].reshape(3, -1, 2)[:, cols]
        mixed = np.einsum("mab,cmb->cma", by_landmark, cross) + np.einsum(
            "ac,mbc->amb", joint[:3, :3], self.by_pose[cols]
        )
        shift = mixed.reshape(3, -1) @ np.linalg.solve(S, self.pairs.values[rows, cols].ravel())
        return Pose(*(pose.array() + shift))


def compare(observed: Observed, noise: Array, estimate: Estimate, near: Indices, joint: Array) -> Innovations:
    """Innovations of all observations against the landmarks at `near` (k,), whose covariance with the pose is `joint`.

    `noise` (m, 1 or k, 2, 2) covariances of the observations.
    """
    walls = estimate.walls[near]
    predicted, by_pose, by_landmark = predict(estimate.pose, estimate.landmarks[near], walls)
    values, noise = observation_innovations(observed.z[:, None, :], noise, predicted[None, :, :], walls[None, :])
    cov = predicted_cov(joint, by_pose, by_landmark)
    k = np.arange(len(near))
    S = cov.reshape(len(k), 2, len(k), 2)[k, :, k, :][None] + noise  # (m, k, 2, 2)
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    a, b = values[..., 0], values[..., 1]
    squared = (a * a * S[..., 1, 1] - 2 * a * b * S[..., 0, 1] + b * b * S[..., 0, 0]) / det
    pairs = Pairs(values, np.ascontiguousarray(noise), cov)
    return Innovations(pairs, squared, np.log(det), by_pose, by_landmark, predicted, walls)


def compare_known(
    observations: Mapping[LandmarkId, Observation], known: list[LandmarkId], estimate: Estimate, estimator: Belief
) -> tuple[Innovations, Array]:
    """Innovations of the observations of landmarks that are known, and the joint covariance of these."""
    order = {i: k for k, i in enumerate(estimate.ids.tolist())}
    near, seen = np.array([order[i] for i in known]), Observed.of([observations[i] for i in known])
    joint = estimator.joint_covariance(known)
    return compare(seen, seen.cov[:, None], estimate, near, joint), joint


def predicted_cov(joint: Array, by_pose: Array, by_landmark: Array) -> Array:
    """(2k, 2k) covariance of the predicted observations of k landmarks, from the joint one of pose and landmarks."""
    k = len(by_pose)
    pose, cross, own = joint[:3, :3], joint[:3, 3:].reshape(3, k, 2), joint[3:, 3:].reshape(k, 2, k, 2)
    H = by_pose.reshape(-1, 3)
    turned = np.einsum("jab,cjb->cja", by_landmark, cross).reshape(3, -1)
    mixed = H @ turned
    turned_own = np.matmul(by_landmark[:, None], own.transpose(0, 2, 1, 3)) @ by_landmark.transpose(0, 2, 1)[None]
    return np.asarray(H @ pose @ H.T + mixed + mixed.T + turned_own.transpose(0, 2, 1, 3).reshape(2 * k, 2 * k))


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
