"""Links: relative poses of two keyframes by alignment both ways, with the covariance that the scans support.

Apparent poses: a link measures between what two scans seem to be seen from, each with an error of its own.

A scan takes part in many links, and its returns have the same errors in all of them. The graph therefore holds apparent
poses, each the true pose and one private error of its scan. That error does not average out over links. It is added to
the covariance of a pose that is reported, and so is that of the first pose, which the world's frame is fixed to.
Mourikis and Roumeliotis, "Analysis of Positioning Uncertainty in Simultaneous Localization and Mapping (SLAM)",
IROS 2004, treat the same correlation for relative-pose measurements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import (
    added,
    between,
    eigen,
    in_axes,
    inverse,
    move_covariance,
    put,
    symmetrized,
    triple,
)
from sixthsense.slam.scans.alignment import (
    HITS,
    SIGMA_M,
    SQUARES,
    SUMS,
    WEIGHT,
    Prior,
    Views,
    align,
    told,
)
from sixthsense.slam.scans.returns import Returns
from sixthsense.slam.scans.visibility import compare_views

NEAR_GATE_M, WIDE_GATE_M = 0.25, 0.5
"""first gates of pairs whose relative pose is known to two decimetres, and to half a metre"""
_ANCHOR = 1.0  # returns' worth that holds the start value where the scans say nothing; no information of the link
LEAST_HITS = 20  # partners found, both ways
SEEN_SHARE = 0.3  # of the returns of either scan that lie on returns of the other
_SHAPE_SHARE, _LEVER_M = 0.1, 3.0  # of the shape's sigma that stays in the pose, and what turns it into an angle
_FLOOR_M = 3e-4
FEW_RETURNS = 3.0
"""returns' worth of information that wrong partners may feign"""
_UNOBSERVED = 1000.0  # sigma, m or rad, where scans say nothing: many links together must not say more than the motion


class Alignments(NamedTuple):
    """Aligned pairs of keyframes; arrays of m rows."""

    targets: NDArray[np.int64]
    sources: NDArray[np.int64]
    poses: Array
    """(m, 3) of the source in the target's frame"""
    sums: Array
    """(m, SUMS) at these poses"""
    views: NDArray[np.int64]
    """(m, 2, 3) hits, violations and returns, of the source seen by the target and the other way round"""
    moved_m: Array
    """(m,) how far each pose is from where its alignment began"""

    def agree(self, least_agreement: float, usual: float, least_seen: float = SEEN_SHARE) -> NDArray[np.bool_]:
        """(m,) whether both scans show one place: enough partners, and few returns where the other saw through.

        `least_agreement` is the least share of hits among hits and violations, where `usual` is 1: the share of a
        scan's returns, of those that are judged, that usually agree. People hide and add some in any scan. `least_seen`
        is the least share of hits among all returns.
        """
        seen, through, count = self.views[:, :, 0], self.views[:, :, 1], self.views[:, :, 2]
        is_shared = (seen >= usual * least_seen * count) & (seen >= usual * least_agreement * (seen + through))
        return np.asarray((self.sums[:, HITS] >= LEAST_HITS) & is_shared.all(axis=1))

    def rows(self, chosen: NDArray[np.int64]) -> Alignments:
        """Some of them."""
        return Alignments._make(values[chosen] for values in self)

    @classmethod
    def of(cls, rows: Sequence[tuple[Alignments, int]]) -> Alignments:
        """Those of rows, at least one."""
        return cls._make(np.array([getattr(found, name)[k] for found, k in rows]) for name in cls._fields)

    def tell(self) -> NDArray[np.bool_]:
        """(m,) whether either scan saw enough of the place of the other's returns to agree or to contradict."""
        return np.asarray(self.views[:, :, :2].sum(axis=2).min(axis=1) >= LEAST_HITS)


@numba.njit(cache=True, error_model="numpy")
def covariances(sums: Array, shared_by: Array, sigma_m: float) -> Array:
    """(m, 3, 3) of the errors of (x, y, theta) of aligned pairs with `sums` (m, SUMS), axes of the targets.

    `shared_by` (m,) is the number of scans that share the information, at least 2, and `sigma_m` the least sigma of a
    return. A scan of m links has the information of its returns once: against a map of m scans, whose points have 1 / m
    of its variance, that is m / (m + 1) of what a map without noise would give, and m + 1 share it. The residuals
    themselves give their variance. What the noise of the normals adds to the Hessian is no information: along a
    corridor it would seem to be some, as would a few wrong partners at the edges of doors: a direction of which only so
    many returns tell is not observed. What the residuals have beyond the noise of the laser is shape, common to
    neighbouring returns: a part of it stays in the pose, however many returns there are.
    """
    noise, out = 2.0 * sigma_m**2, np.empty((len(sums), 3, 3))
    for k in range(len(sums)):
        variance = max(sums[k, SQUARES] / max(sums[k, WEIGHT], 1.0), noise)
        floor = _SHAPE_SHARE**2 * (variance - noise) + _FLOOR_M**2
        # Both ways the returns of a pair are counted twice.
        returns, axes = eigen(told(sums[k], 2.0))
        share = 2.0 / (max(shared_by[k], 2.0) * variance)
        for i in range(3):
            returns[i] = 1.0 / max(share * max(returns[i] - FEW_RETURNS, 0.0), _UNOBSERVED**-2)
        put(out, k, in_axes(returns, axes))
        for i, shape in enumerate((floor, floor, floor * _LEVER_M**-2)):
            out[k, i, i] += shape
    return out


def align_with(returns: Returns, targets: NDArray[np.int64], key: int, poses: Array, gate_m: float) -> Alignments:
    """Align a scan with others from where their `poses` (K, 3) say."""
    return align_pairs(returns, targets, np.full(len(targets), key), between(poses[targets], poses[key]), gate_m)


@numba.njit(cache=True, error_model="numpy")
def align_pairs(
    returns: Returns, targets: NDArray[np.int64], sources: NDArray[np.int64], starts: Array, gate_m: float
) -> Alignments:
    """Align pairs of scans from the relative poses `starts` (m, 3), and compare their views."""
    m = len(targets)
    poses, sums, views = starts.copy(), np.zeros((m, SUMS)), np.zeros((m, 2, 3), dtype=np.int64)
    moved_m = np.empty(m)
    anchor, origin = np.zeros((3, 3)), np.zeros((1, 3))
    anchor[0, 0] = anchor[1, 1] = anchor[2, 2] = _ANCHOR / SIGMA_M**2
    for k in range(m):
        target, source, pose = targets[k], sources[k], poses[k]
        prior = Prior(pose.copy(), anchor, math.inf)
        align(Views(returns, source, targets[k : k + 1], origin, 1.0), prior, gate_m, True, pose, sums[k])
        views[k, 0, 0], views[k, 0, 1], views[k, 0, 2] = compare_views(returns, target, source, pose)
        views[k, 1, 0], views[k, 1, 1], views[k, 1, 2] = compare_views(
            returns, source, target, np.array(inverse(triple(pose)))
        )
        moved_m[k] = math.hypot(pose[0] - starts[k, 0], pose[1] - starts[k, 1])
    return Alignments(targets, sources, poses, sums, views, moved_m)


@numba.njit(cache=True, error_model="numpy")
def private_covariance(returns: Returns, key: int, sigma_m: float) -> Array:
    """(3, 3) of the private error of a scan's apparent pose, axes of its laser: H^-1 N H^-1.

    H is the Hessian of the distances of the scan's returns from their lines by the pose, less what the noise of the
    normals feigns, and N its gradient's covariance, where a range has the laser's noise `sigma_m`: across a wall that
    is as much of it as the beam meets the wall head-on. Along a direction that the scan does not observe the apparent
    pose says nothing, and there is no such error: what the odometry says there is in the graph.
    """
    points, normals = returns.points[key], returns.normals[key]
    hessian, gradient = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(len(points)):
        x, y, distance = float(points[k, 0]), float(points[k, 1]), float(points[k, 2])
        nx, ny, variance = float(normals[k, 0]), float(normals[k, 1]), float(normals[k, 2])
        if distance <= 0.0 or (nx == 0.0 and ny == 0.0):
            continue
        across, along = (nx, ny, x * ny - y * nx), (-ny, nx, x * nx + y * ny)
        cosine_squared = (along[2] / distance) ** 2
        for i in range(3):
            for j in range(3):
                hessian[i, j] += across[i] * across[j] - along[i] * variance * along[j]
                gradient[i, j] += across[i] * cosine_squared * across[j]
    weights, axes = eigen(hessian)
    for k in range(3):
        weights[k] = 1.0 / weights[k] if weights[k] > FEW_RETURNS else 0.0
    inverse, left, out = in_axes(weights, axes), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            terms = inverse[i, 0] * gradient[0, j] + inverse[i, 1] * gradient[1, j] + inverse[i, 2] * gradient[2, j]
            left[i, j] = sigma_m**2 * terms
    for i in range(3):
        for j in range(3):
            out[i, j] = left[i, 0] * inverse[0, j] + left[i, 1] * inverse[1, j] + left[i, 2] * inverse[2, j]
    return out


@numba.njit(cache=True, error_model="numpy")
def reported(cov: Array, pose: Array, own: Array, first: Array, start: Array) -> Array:
    """(3, 3) covariance of a true pose (3,) from that of its apparent pose, world axes.

    `own` and `first` (3, 3) are the private covariances of its scan and of the first one, which was seen from `start`
    (3,), both in the axes of their lasers. The error of the first turns and shifts all that follows.
    """
    turned = move_covariance((0.0, 0.0, pose[2]), own)
    moved = move_covariance((start[0] - pose[0], start[1] - pose[1], start[2]), first)
    return symmetrized(added(added(cov, turned), moved))  # a solver's marginal is symmetric to 1e-9 only
