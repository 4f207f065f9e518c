"""Links: relative poses of two keyframes by alignment both ways, with the covariance that the scans support.

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
from sixthsense.core.se2 import inverse, move_covariance, triple
from sixthsense.slam.scans.agreement import LEAST_RETURNS, agreement
from sixthsense.slam.scans.alignment import SIGMA_M, Prior, Sums, Views, align, no_sums
from sixthsense.slam.scans.returns import Returns

WIDE_GATE_M = 0.5
"""first gate of pairs whose relative pose is known to half a metre"""
NEAR_GATE_M = 0.5 * WIDE_GATE_M
"""the same of those that are known twice as well"""
AGREEMENT, SEEN_SHARE = 0.75, 0.3
"""least shares of hits, among hits and returns that are seen through, and among all, of the usual one"""
FEW_RETURNS = 3.0
"""returns that a few wrong partners seem to add where nothing is observed"""
_UNOBSERVED = 1000.0  # sigma, m or rad, where scans say nothing: many links together must not say more than the motion


class Alignments(NamedTuple):
    """Aligned pairs of keyframes; arrays of m rows."""

    targets: NDArray[np.int64]
    sources: NDArray[np.int64]
    poses: Array
    """(m, 3) of the source in the target's frame"""
    hessians: Array
    """(m, 3, 3) of half the squares of the distances, both ways, without what the normals' noise adds"""
    partners: Array
    """(m,) of returns, both ways"""
    seen: Array
    """(m, 2, 4) `Agreement` of the source seen by the target, and the other way round"""

    def agree(self, usual: float, least_seen: float = SEEN_SHARE) -> NDArray[np.bool_]:
        """(m,) whether both scans show one place: enough partners, and few returns where the other saw through.

        `usual` is the share of a scan's returns, of those that are judged, that usually agree: people hide and add some
        in any scan. `least_seen` is the least share of hits among all returns.
        """
        hits, through, count = self.seen[:, :, 1], self.seen[:, :, 2], self.seen[:, :, 3]
        is_shared = (hits >= usual * least_seen * count) & (hits >= usual * AGREEMENT * (hits + through))
        return np.asarray((self.partners >= LEAST_RETURNS) & is_shared.all(axis=1))

    def rows(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Alignments:
        """Some of them."""
        return Alignments._make(values[chosen] for values in self)

    @classmethod
    def joined(cls, parts: Sequence[Alignments]) -> Alignments:
        """Those of all parts, of which there is one at least."""
        return cls._make(np.concatenate(values) for values in zip(*parts, strict=True))


def covariances(hessians: Array, sigma_m: float) -> Array:
    """(m, 3, 3) of the errors of (x, y, theta) of aligned pairs, axes of the targets, by the noise of their returns.

    `hessians` (m, 3, 3) are those of `Alignments`, in which both ways count the returns of a pair twice. `sigma_m` is
    of a return. A direction that a few returns observe is not observed.
    """
    # Half for the two ways; the noise of both returns of a pair is in its distance.
    values, axes = np.linalg.eigh(0.5 * hessians)
    information = np.maximum(values - FEW_RETURNS, 0.0) / (2.0 * sigma_m**2)
    variances = 1.0 / np.maximum(information, _UNOBSERVED**-2)
    return np.asarray((axes * variances[:, None, :]) @ axes.transpose(0, 2, 1))


@numba.njit(cache=True, error_model="numpy")
def align_pairs(
    returns: Returns, targets: NDArray[np.int64], sources: NDArray[np.int64], starts: Array, gate_m: float
) -> Alignments:
    """Align pairs of scans from the relative poses `starts` (m, 3), and compare what they saw."""
    m = len(targets)
    poses, seen, sums = starts.copy(), np.zeros((m, 2, 4)), no_sums(m)
    anchor, origin = np.eye(3) / SIGMA_M**2, np.zeros((1, 3))  # of one return: it holds what the scans do not observe
    for k in range(m):
        target, source, pose = targets[k], sources[k], poses[k]
        own = Sums(sums.hessian[k], sums.feigned[k], sums.gradient[k], sums.partners[k : k + 1])
        views, prior = Views(returns, source, targets[k : k + 1], origin, 1.0), Prior(pose.copy(), anchor, math.inf)
        align(views, prior, gate_m, True, pose, own)
        there, back = (
            agreement(returns, target, source, triple(pose)),
            agreement(returns, source, target, inverse(triple(pose))),
        )
        for i in range(4):
            seen[k, 0, i], seen[k, 1, i] = there[i], back[i]
    return Alignments(targets, sources, poses, sums.hessian - sums.feigned, sums.partners, seen)


def private_covariance(returns: Returns, key: int, sigma_m: float) -> Array:
    """(3, 3) of the private error of a scan's apparent pose, axes of its laser: H^-1 N H^-1.

    H is the Hessian of the distances of the scan's returns from their lines by the pose, without what the noise of the
    normals adds, and N its gradient's covariance, where a range has the laser's noise `sigma_m`: across a wall that is
    as much of it as the beam meets the wall head-on. Along a direction that the scan does not observe there is no such
    error: what the odometry measures there is in the graph.
    """
    points, normals = returns.points[key].astype(np.float64), returns.normals[key].astype(np.float64)
    used = (points[:, 2] > 0.0) & normals[:, :2].any(axis=1)
    (x, y, distance), (nx, ny, variance) = points[used].T, normals[used].T
    across, along = np.array([nx, ny, x * ny - y * nx]), np.array([-ny, nx, x * nx + y * ny])
    values, axes = np.linalg.eigh(across @ across.T - along * variance @ along.T)
    inverse = (axes * np.where(values > FEW_RETURNS, 1.0 / np.maximum(values, FEW_RETURNS), 0.0)) @ axes.T
    gradient = across * (along[2] / distance) ** 2 @ across.T
    return np.asarray(sigma_m**2 * inverse @ gradient @ inverse)


def reported(cov: Array, pose: Array, own: Array, first: Array, start: Array) -> Array:
    """(3, 3) covariance of a true pose (3,) from that of its apparent pose, world axes.

    `own` and `first` (3, 3) are the private covariances of its scan and of the first one, which was seen from `start`
    (3,), both in the axes of their lasers. The error of the first turns and shifts all that follows.
    """
    turned = move_covariance((0.0, 0.0, float(pose[2])), own)
    moved = move_covariance(triple(np.array([*(start[:2] - pose[:2]), start[2]])), first)
    total = cov + turned + moved
    return np.asarray(0.5 * (total + total.T))  # a solver's marginal is symmetric to 1e-9 only
