"""Innovations of observations against landmarks (report section 4.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import innovation, innovations_of, predictions
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.pose_kernels import Triple
from sixthsense.slam.association.crookedness import unit_cov
from sixthsense.slam.association.joint_assignment import Indices, Pairs
from sixthsense.slam.association.observed import Mask, Observed
from sixthsense.slam.estimators.base import Belief, Estimate


class Innovations(NamedTuple):
    """Innovations of m observations against k landmarks, for all pairs."""

    pairs: Pairs
    """with their covariances"""
    squared: Array
    """(m, k) squared Mahalanobis distance"""
    log_det: Array
    """(m, k) logarithm of the determinant of the innovation's covariance"""
    with_pose: Array
    """(2k, 3) covariance of the predicted observations with the pose"""
    predicted: Array
    """(k, 2) predicted observations"""
    walls: Mask
    """(k,) which of the landmarks are walls"""

    def pose_given(self, pose: Pose, matched: Indices) -> Pose:
        """The predicted `pose` updated with matches (m,), -1: none."""
        x, y, theta = _shift(self.pairs, self.with_pose, matched)
        return Pose(pose.x + x, pose.y + y, pose.theta + theta)

    def worth(self, matched: Indices, gate: float) -> float:
        """Of matches (m,), -1: none: the gate for each, less their squared innovation together."""
        rows = np.flatnonzero(matched >= 0)
        cols = matched[rows]
        joint = _joint(self.pairs.predicted, cols, self.pairs.noise[rows, cols])
        return gate * len(rows) - float(_nis(self.pairs.values[rows, cols], joint))

    def nis(self, observations: Sequence[Observation], landmarks: Indices) -> float:
        """Normalised innovation squared of observations of the `landmarks` (n,), with the correlations between them.

        The observations need not be those that were compared.
        """
        if not observations:
            return 0.0
        z, cov = np.array([s.z for s in observations]), np.array([s.cov for s in observations])
        values, noise = innovations_of(z, cov, self.predicted[landmarks], self.walls[landmarks])
        return float(_nis(values, _joint(self.pairs.predicted, landmarks, noise)))


def compare(observed: Observed, squares_m2: Array, estimate: Estimate, near: Indices, joint: Array) -> Innovations:
    """Innovations of all observations against the landmarks at `near` (k,), whose covariance with the pose is `joint`.

    The walls among these deviate from straight ones by a mean square of `squares_m2` (k,).
    """
    pose = estimate.pose.x, estimate.pose.y, estimate.pose.theta
    return _compared(observed, squares_m2, pose, estimate.landmarks[near], estimate.walls[near], joint)


def compare_known(
    observations: Mapping[LandmarkId, Observation], known: list[LandmarkId], estimate: Estimate, estimator: Belief
) -> Innovations:
    """Innovations of the observations of landmarks that are known."""
    order = {i: k for k, i in enumerate(estimate.ids.tolist())}
    near, seen = np.array([order[i] for i in known]), Observed.of([observations[i] for i in known])
    return compare(seen, np.zeros(len(known)), estimate, near, estimator.joint_covariance(known))


@numba.njit(cache=True, error_model="numpy")
def _compared(
    observed: Observed, squares_m2: Array, pose: Triple, landmarks: Array, walls: Mask, joint: Array
) -> Innovations:
    m, k = len(observed.z), len(landmarks)
    predicted, by_pose, by_landmark = predictions(pose, landmarks, walls)
    with_state = _by_state(by_pose, by_landmark, joint)
    predicted_cov = _by_state(by_pose, by_landmark, np.ascontiguousarray(with_state.T))
    values, noise = np.empty((m, k, 2)), np.empty((m, k, 2, 2))
    squared, log_det = np.empty((m, k)), np.empty((m, k))
    for i in range(m):
        of_shape = unit_cov(observed.extents[i, 0], observed.extents[i, 1], observed.walls[i])
        for j in range(k):
            own = observed.cov[i] + squares_m2[j] * of_shape
            innovation(observed.z[i], own, predicted[j], walls[j], values[i, j], noise[i, j])
            a, b = values[i, j]
            s00 = predicted_cov[2 * j, 2 * j] + noise[i, j, 0, 0]
            s10 = predicted_cov[2 * j + 1, 2 * j] + noise[i, j, 1, 0]
            s11 = predicted_cov[2 * j + 1, 2 * j + 1] + noise[i, j, 1, 1]
            det = s00 * s11 - s10 * s10
            squared[i, j] = (a * a * s11 - 2.0 * a * b * s10 + b * b * s00) / det
            log_det[i, j] = np.log(det)
    pairs = Pairs(values, noise, predicted_cov)
    return Innovations(pairs, squared, log_det, np.ascontiguousarray(with_state[:, :3]), predicted, walls)


@numba.njit(cache=True, error_model="numpy")
def _by_state(by_pose: Array, by_landmark: Array, of_state: Array) -> Array:
    """(2k, c) the Jacobian of k predicted observations by the pose and the landmarks, times `of_state` (3 + 2k, c)."""
    k, columns = len(by_pose), of_state.shape[1]
    out = np.zeros((2 * k, columns))
    for row in range(2 * k):
        j, a = row // 2, row % 2
        for c in range(columns):
            for p in range(3):
                out[row, c] += by_pose[j, a, p] * of_state[p, c]
            for p in range(2):
                out[row, c] += by_landmark[j, a, p] * of_state[3 + 2 * j + p, c]
    return out


@numba.njit(cache=True, error_model="numpy")
def _joint(predicted_cov: Array, landmarks: Indices, noise: Array) -> Array:
    """(2n, 2n) joint covariance of the innovations of n observations with `noise` (n, 2, 2) of `landmarks` (n,)."""
    n = len(landmarks)
    S = np.empty((2 * n, 2 * n))
    for a in range(2 * n):
        for b in range(2 * n):
            S[a, b] = predicted_cov[2 * landmarks[a // 2] + a % 2, 2 * landmarks[b // 2] + b % 2]
    for k in range(n):
        S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += noise[k]
    return S


@numba.njit(cache=True, error_model="numpy")
def _nis(values: Array, S: Array) -> float:
    stacked = values.ravel()
    return float(stacked @ np.linalg.solve(S, stacked))


@numba.njit(cache=True, error_model="numpy")
def _shift(pairs: Pairs, with_pose: Array, matched: Indices) -> Triple:
    """Of the pose, by the update with matches (m,), -1: none; report eq. 10."""
    rows = np.flatnonzero(matched >= 0)
    cols = matched[rows]
    n = len(rows)
    values, noise, cross = np.empty(2 * n), np.empty((n, 2, 2)), np.empty((2 * n, 3))
    for k in range(n):
        values[2 * k : 2 * k + 2], noise[k] = pairs.values[rows[k], cols[k]], pairs.noise[rows[k], cols[k]]
        cross[2 * k : 2 * k + 2] = with_pose[2 * cols[k] : 2 * cols[k] + 2]
    x, y, theta = np.linalg.solve(_joint(pairs.predicted, cols, noise), values) @ cross
    return x, y, theta
