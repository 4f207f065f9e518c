"""Which sightings may be of which landmarks, and how likely: geometry first, then gates on the innovation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Sighting, innovations, predict
from sixthsense.slam.association.align import Alignment
from sixthsense.slam.association.walls import ends, nearness
from sixthsense.slam.estimators.base import Estimate

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_TURN_RAD = (0.15, 0.6)  # walls within the first may be one whatever the heading's sigma, beyond the second never
_REACH_M = 0.3  # likewise for their offsets


@dataclass(frozen=True, slots=True)
class Pairs:
    """How m sightings lie to n landmarks."""

    plausible: Mask
    """(m, n) worth a look at the innovation"""
    apart: Mask
    """(m, n) far enough from each other for the sighting to be of another landmark"""
    sigmas: Array
    """(m,) sigma, at most, of where points, or the middles of walls, lie in the world; m"""


def pairs(
    sightings: Sequence[Sighting],
    estimate: Estimate,
    aligned: Alignment,
    sigmas: Array,
    extents: Array,
    gates: float,
    cfg: AssociationConfig,
) -> Pairs:
    """Compare sightings with all landmarks of the estimate, as seen from the aligned pose.

    `sigmas` (n,) metres, what each point is known to at worst; `extents` (n, 2, 2) ends of walls; `gates` in sigmas.
    The sigma of a difference is at most the sum of both, however they are correlated: a point that is left out here
    could not have passed a gate. Sigmas of landmarks shrink; the factor leaves room for what linearising anew changes.
    Walls that lie on others once the scan is aligned have no need of such room.
    """
    shape = len(sightings), len(estimate.ids)
    plausible, apart = np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool)
    own = _world_sigmas(sightings, estimate)
    pose, fits = aligned.pose, aligned.explained >= cfg.align.enough
    walls = np.array([s.is_wall for s in sightings], dtype=bool)
    rows, cols = np.flatnonzero(~walls), np.flatnonzero(~estimate.walls)
    if len(rows) and len(cols):
        positions = pose @ np.array([sightings[k].z for k in rows.tolist()])
        gap = positions[:, None, :] - estimate.landmarks[None, cols, :]
        distance = np.hypot(gap[..., 0], gap[..., 1])
        reach = np.minimum(cfg.pre_gate_m, gates * (own[rows, None] + 2.0 * sigmas[None, cols]))
        plausible[np.ix_(rows, cols)] = distance < reach
        apart[np.ix_(rows, cols)] = distance > cfg.new_separation_m
    rows, cols = np.flatnonzero(walls), np.flatnonzero(estimate.walls)
    if len(rows) and len(cols):
        sighted = np.array([ends(pose, sightings[k]) for k in rows.tolist()])
        alphas = np.array([sightings[k].z[0] for k in rows.tolist()]) + pose.theta
        near = nearness(sighted, alphas, estimate.landmarks[cols], extents[cols])
        angle, offset, in_line = np.abs(near.angle), np.abs(near.offset), near.gap < cfg.wall_gap_m
        turn, reach = _TURN_RAD[0], np.full(len(rows), _REACH_M)
        if not fits:
            turn = float(np.clip(gates * math.sqrt(estimate.pose_cov[2, 2]), *_TURN_RAD))
            reach = np.clip(gates * own[rows], _REACH_M, cfg.pre_gate_m)
        plausible[np.ix_(rows, cols)] = in_line & (angle < turn) & (offset < reach[:, None])
        apart[np.ix_(rows, cols)] = ~(in_line & (angle < _TURN_RAD[0]) & (offset <= cfg.new_separation_m))
    return Pairs(plausible, apart, own)


def _world_sigmas(sightings: Sequence[Sighting], estimate: Estimate) -> Array:
    """(m,) sigma, at most, of where points, or the middles of walls, lie in the world; m."""
    cov = estimate.pose_cov
    out = np.empty(len(sightings))
    for k, s in enumerate(sightings):
        if s.is_wall:
            middle = 0.5 * (s.extent[0] + s.extent[1])
            own = s.cov[1, 1] - 2.0 * middle * s.cov[0, 1] + middle**2 * s.cov[0, 0]
            reach = math.hypot(float(s.z[1]), middle)
        else:
            own, reach = s.cov[0, 0] + s.cov[1, 1], math.hypot(*s.z)
        out[k] = math.sqrt(max(own, 0.0)) + reach * math.sqrt(cov[2, 2])
    return out + math.sqrt(cov[0, 0] + cov[1, 1])


@dataclass(frozen=True, slots=True)
class Innovations:
    """Innovations of m sightings against k landmarks, whether they belong together or not."""

    values: Array
    """(m, k, 2)"""
    squared: Array
    """(m, k) squared Mahalanobis distance, infinite where the pair is not plausible"""
    log_det: Array
    """(m, k) logarithm of the determinant of the innovation's covariance"""
    by_pose: Array
    """(k, 2, 3)"""
    by_landmark: Array
    """(k, 2, 2)"""
    predicted: Array
    """(k, 2) sightings"""
    walls: Mask
    """(k,) which of the landmarks are walls"""


def compare(
    sightings: Sequence[Sighting], estimate: Estimate, near: Indices, joint: Array, plausible: Mask
) -> Innovations:
    """Innovations of all sightings against the landmarks at `near` (k,), whose covariance with the pose is `joint`."""
    walls = estimate.walls[near]
    predicted, by_pose, by_landmark = predict(estimate.pose, estimate.landmarks[near], walls)
    z = np.array([s.z for s in sightings])
    noise = np.array([s.cov for s in sightings])
    values = innovations(z[:, None, :], predicted[None, :, :], walls[None, :])
    S = predicted_covs(joint, by_pose, by_landmark)[None] + noise[:, None]  # (m, k, 2, 2)
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    a, b = values[..., 0], values[..., 1]
    squared = (a * a * S[..., 1, 1] - 2 * a * b * S[..., 0, 1] + b * b * S[..., 0, 0]) / det
    squared = np.where(plausible, squared, np.inf)
    return Innovations(values, squared, np.log(det), by_pose, by_landmark, predicted, walls)


def assign(innovation: Innovations, gate: float) -> tuple[Indices, Indices]:
    """The one-to-one matches inside the gate, likeliest together: rows (sightings) and columns (landmarks)."""
    inside = innovation.squared < gate
    # The likelier landmark wins: the distance alone would favour the one that is less well known.
    cost = np.where(inside, innovation.squared + innovation.log_det, 1e6)
    rows, cols = linear_sum_assignment(cost)
    paired = inside[rows, cols]
    return rows[paired], cols[paired]


def predicted_covs(joint: Array, by_pose: Array, by_landmark: Array) -> Array:
    """(k, 2, 2): H Sigma H^T of each landmark's sighting, from the joint covariance of pose and landmarks."""
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
    S = H @ joint @ H.T + block_diag(*noise)
    stacked = innovation.ravel()
    return float(stacked @ np.linalg.solve(S, stacked))


def stacked_jacobian(by_pose: Array, by_landmark: Array) -> Array:
    """(2m, 3 + 2m) Jacobian of m predicted sightings by the pose and the landmarks, in order."""
    m = len(by_pose)
    H = np.zeros((2 * m, 3 + 2 * m))
    H[:, :3] = by_pose.reshape(2 * m, 3)
    for k in range(m):
        H[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = by_landmark[k]
    return H
