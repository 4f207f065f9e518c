"""Extents of walls, which are in no estimator's state, and walls that may be one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Observation, line_errors, observation_innovations, observed_centre
from sixthsense.slam.association.observed import Distances

_PARALLEL_RAD = 0.15  # largest angle between two walls that may be one


def ends(pose: Pose, observation: Observation) -> Array:
    """(2, 2) both ends, in the world, of a wall that is observed from `pose`."""
    c, s = np.cos(observation.z[0]), np.sin(observation.z[0])
    foot, along = observation.z[1] * np.array([c, s]), np.array([-s, c])
    return np.asarray(pose @ (foot + np.outer(observation.extent, along)))


def collinear_pairs(
    landmarks: Array, extents: Array, recent: NDArray[np.bool_], gap_m: float, offset_m: float
) -> list[tuple[int, int]]:
    """Pairs of walls (n, 2), at least one of them `recent` (n,), that may be one by direction, offset and extent."""
    pairs: list[tuple[int, int]] = []
    mine, walls = np.flatnonzero(recent), np.ones(len(landmarks), dtype=bool)
    if not len(mine):
        return pairs
    near = Distances.between(extents[mine], landmarks[mine, 0], walls[mine], landmarks, walls, extents)
    close = (near.turn_rad < _PARALLEL_RAD) & (near.metres <= offset_m) & (near.gap_m < gap_m)
    for j, k in zip(*np.nonzero(close), strict=True):
        first, second = int(mine[j]), int(k)
        if first != second and not (recent[second] and second < first):
            pairs.append((first, second))
    return pairs


def disagreement(first: Array, second: Array, cov: Array) -> float:
    """Squared Mahalanobis distance between two walls (2,) in one frame, whose difference has `cov` (2, 2)."""
    gap, cov = observation_innovations(first, cov, second, np.array(True))
    return float(gap @ np.linalg.solve(cov, gap))


def joined(landmark: Array, *extents: Array) -> Array:
    """(2, 2) ends, on a landmark (2,), of the smallest extent that covers several extents (2, 2)."""
    c, s = np.cos(landmark[0]), np.sin(landmark[0])
    normal, along = np.array([c, s]), np.array([-s, c])
    reach = np.concatenate([extent @ along for extent in extents])
    return np.asarray(landmark[1] * normal + np.outer([reach.min(), reach.max()], along))


def fused(first: Observation, second: Observation) -> Observation:
    """One observation of a wall from two pieces of it in the same scan, whose errors are independent."""
    gap, second_cov = observation_innovations(second.z, second.cov, first.z, np.array(True))
    gain = first.cov @ np.linalg.inv(first.cov + second_cov)
    turn, shift = gain @ gap
    lever, _, _ = line_errors(first.cov)
    alpha = wrap_angle(float(first.z[0]) + turn)
    centre = observed_centre(first)  # it turns about its centre, and is shifted there
    z = np.array([alpha, math.cos(alpha) * centre[0] + math.sin(alpha) * centre[1] + shift - lever * turn])
    cov = first.cov - gain @ first.cov
    extent = min(first.extent[0], second.extent[0]), max(first.extent[1], second.extent[1])
    bearings = np.concatenate([first.bearings, second.bearings])
    return Observation(first.kind, z, 0.5 * (cov + cov.T), extent, bearings, first.shape)
