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
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import inverse
from sixthsense.slam.scans.alignment import (
    HESSIAN,
    HITS,
    SIGMA_M,
    SPREAD,
    SQUARES,
    SUMS,
    WEIGHT,
    Prior,
    Views,
    align,
)
from sixthsense.slam.scans.returns import Returns
from sixthsense.slam.scans.visibility import compare_views

TRACKED_GATE_M, NEAR_GATE_M, WIDE_GATE_M = 0.15, 0.25, 0.5
"""first gates of pairs whose relative pose is known to centimetres, to two decimetres, and to half a metre"""
_ANCHOR = 1.0  # returns' worth that holds the start value where the scans say nothing; no information of the link
LEAST_HITS = 20  # partners found, both ways
SEEN_SHARE = 0.3  # of the returns of either scan that lie on returns of the other
_SHAPE_SHARE, _LEVER_M = 0.1, 3.0  # of the shape's sigma that stays in the pose, and what turns it into an angle
_FLOOR_M = 3e-4
FEW_RETURNS = 3.0
"""returns' worth of information that wrong partners may feign"""
_UNOBSERVED = 1000.0  # sigma, m or rad, where scans say nothing: many links together must not say more than the motion


@dataclass(frozen=True, slots=True)
class Alignments:
    """Aligned pairs of keyframes; arrays of m rows."""

    targets: NDArray[np.int64]
    sources: NDArray[np.int64]
    poses: Array
    """(m, 3) of the source in the target's frame"""
    sums: Array
    """(m, SUMS) at these poses"""
    views: NDArray[np.int64]
    """(m, 2, 3) hits, violations and returns, of the source seen by the target and the other way round"""

    def agree(self, least_agreement: float, usual: float, least_seen: float = SEEN_SHARE) -> NDArray[np.bool_]:
        """(m,) whether both scans show one place: enough partners, and few returns where the other saw through.

        `least_agreement` is the least share of hits among hits and violations, where `usual` is 1: the share of a
        scan's returns, of those that are judged, that usually agree. People hide and add some in any scan. `least_seen`
        is the least share of hits among all returns.
        """
        seen, through, count = self.views[:, :, 0], self.views[:, :, 1], self.views[:, :, 2]
        is_shared = (seen >= usual * least_seen * count) & (seen >= usual * least_agreement * (seen + through))
        return np.asarray((self.sums[:, HITS] >= LEAST_HITS) & is_shared.all(axis=1))

    def tell(self) -> NDArray[np.bool_]:
        """(m,) whether either scan saw enough of the place of the other's returns to agree or to contradict."""
        return np.asarray(self.views[:, :, :2].sum(axis=2).min(axis=1) >= LEAST_HITS)


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
    noise = 2.0 * sigma_m**2
    variance = np.maximum(sums[:, SQUARES] / np.maximum(sums[:, WEIGHT], 1.0), noise)
    floor = _SHAPE_SHARE**2 * (variance - noise) + _FLOOR_M**2
    # Both ways the returns of a pair are counted twice.
    hessians, (rows, cols) = np.zeros((len(sums), 3, 3)), np.triu_indices(3)
    hessians[:, rows, cols] = 0.5 * (sums[:, HESSIAN : HESSIAN + 6] - sums[:, SPREAD : SPREAD + 6])
    returns, axes = np.linalg.eigh(hessians, UPLO="U")
    share = 2.0 / (np.maximum(shared_by, 2.0) * variance)
    values = share[:, None] * np.maximum(returns - FEW_RETURNS, 0.0)
    spread = 1.0 / np.maximum(values, _UNOBSERVED**-2)
    shape = floor[:, None, None] * np.diag([1.0, 1.0, _LEVER_M**-2])
    return np.asarray((axes * spread[:, None, :]) @ axes.transpose(0, 2, 1) + shape)


def align_pairs(
    returns: Returns, targets: NDArray[np.int64], sources: NDArray[np.int64], starts: Array, gate_m: float
) -> Alignments:
    """Align pairs of scans from the relative poses `starts` (m, 3), and compare their views."""
    m = len(targets)
    poses, sums, views = starts.copy(), np.zeros((m, SUMS)), np.zeros((m, 2, 3), dtype=np.int64)
    _align_all(returns, targets, sources, gate_m, poses, sums, views)
    return Alignments(targets, sources, poses, sums, views)


@numba.njit(cache=True, error_model="numpy")
def _align_all(
    returns: Returns,
    targets: NDArray[np.int64],
    sources: NDArray[np.int64],
    gate_m: float,
    poses: Array,
    sums: Array,
    views: NDArray[np.int64],
) -> None:
    anchor, origin = np.eye(3) * (_ANCHOR / SIGMA_M**2), np.zeros((1, 3))
    for k in range(len(targets)):
        target, source, pose = targets[k], sources[k], poses[k]
        prior = Prior(pose.copy(), anchor, math.inf)
        align(Views(returns, source, targets[k : k + 1], origin), prior, gate_m, True, pose, sums[k])
        views[k, 0, 0], views[k, 0, 1], views[k, 0, 2] = compare_views(returns, target, source, pose)
        views[k, 1, 0], views[k, 1, 1], views[k, 1, 2] = compare_views(returns, source, target, inverse(pose))


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
