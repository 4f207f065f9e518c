"""Extents of walls, which are in no estimator's state, and walls that may be one."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmark_kernels import line_ends
from sixthsense.core.landmarks import Observation, line_errors, observation_innovations, observed_centre
from sixthsense.core.pose_kernels import Triple
from sixthsense.slam.association.observed import Distances

_PARALLEL_RAD = 0.15  # largest angle between two walls that may be one
_ONE_WALL = np.ones(1, dtype=bool)


def ends(pose: Pose, observation: Observation) -> Array:
    """(2, 2) both ends, in the world, of a wall that is observed from `pose`."""
    return _ends((pose.x, pose.y, pose.theta), observation.z, *observation.extent)


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
    (gap,), (about,) = observation_innovations(first[None], cov[None], second[None], _ONE_WALL)
    return float(gap @ np.linalg.solve(about, gap))


@numba.njit(cache=True, error_model="numpy")
def joined(landmark: Array, first: Array, second: Array) -> Array:
    """(2, 2) ends, on a landmark (2,), of the smallest extent that covers two extents (2, 2)."""
    c, s = math.cos(landmark[0]), math.sin(landmark[0])
    low, high = math.inf, -math.inf
    for x, y in (first[0], first[1], second[0], second[1]):
        low, high = min(low, c * y - s * x), max(high, c * y - s * x)
    return line_ends(landmark, low, high)


@numba.njit(cache=True, error_model="numpy")
def _ends(pose: Triple, line: Array, first: float, last: float) -> Array:
    out = line_ends(line, first, last)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(2):
        x, y = out[k]
        out[k] = pose[0] + c * x - s * y, pose[1] + s * x + c * y
    return out


def fused(first: Observation, second: Observation) -> Observation:
    """One observation of a wall from two pieces of it in the same scan, whose errors are independent."""
    (gap,), (second_cov,) = observation_innovations(second.z[None], second.cov[None], first.z[None], _ONE_WALL)
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
