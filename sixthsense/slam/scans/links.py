"""Links: relative poses of two keyframes by alignment both ways, with the covariance that the scans support."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.pose_kernels import wrapped
from sixthsense.slam.scans.alignment import (
    GRADIENT,
    HESSIAN,
    HITS,
    SPREAD,
    SQUARES,
    SUMS,
    WEIGHT,
    Loss,
    add_both_ways,
    inverse,
    matrix,
    next_step,
    solved,
)
from sixthsense.slam.scans.scan_store import Returns
from sixthsense.slam.scans.see_through import compare_views

RECENT_GATES_M = np.array([0.15, *[0.12] * 8])
"""of pairs whose relative pose is known to some centimetres"""
NEAR_GATES_M = np.array([0.25, 0.2, 0.2, 0.15, 0.15, *[0.12] * 6])
"""of pairs whose relative pose is known to two decimetres"""
WIDE_GATES_M = np.array([0.5, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.15, 0.12, 0.12, 0.12, 0.12])
"""of pairs whose relative pose is known to half a metre"""
_SCALE_M = 0.05  # of the loss on points' distances
_ANCHOR = 1.0  # points' worth that holds the start value where the scans say nothing; no information of the link
_STEP_M, _STEP_RAD = 3e-4, 1e-4
_LEAST_HITS, _LEAST_HIT_SHARE = 20, 0.1  # partners found, both ways, and their share of the cells
_MEAN_WEIGHT = 0.5  # of the partners' loss: most must lie on their lines
_SEEN_SHARE = 0.3  # of the returns of either scan that lie on returns of the other
_SHAPE_SHARE, _LEVER_M = 0.1, 3.0  # of the shape's sigma that stays in the pose, and what turns it into an angle
_FLOOR_M = 3e-4
_FEW_RETURNS = 3.0  # returns' worth that wrong partners may feign
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # places of a matrix's entries in its upper triangle
_UNOBSERVED = 10.0  # sigma, m or rad, along a direction of which the scans say nothing


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

    def agree(self, returns: Returns, least_agreement: float) -> NDArray[np.bool_]:
        """(m,) whether both scans show one place: enough partners, and few returns where the other saw through.

        `least_agreement` is the least share of hits among hits and violations.
        """
        cells = 2 * returns.bearings.beams // returns.bearings.stride
        hits, weights = self.sums[:, HITS], self.sums[:, WEIGHT]
        enough = (hits >= max(_LEAST_HITS, _LEAST_HIT_SHARE * cells)) & (weights >= _MEAN_WEIGHT * hits)
        seen, through, count = self.views[:, :, 0], self.views[:, :, 1], self.views[:, :, 2]
        shared = (seen >= _SEEN_SHARE * count).all(axis=1)
        return np.asarray(enough & shared & (seen >= least_agreement * (seen + through)).all(axis=1))

    def covariance(self, k: int, shared_by: float, sigma_m: float) -> Array:
        """(3, 3) of the error of (x, y, theta) of pair k, axes of the target; see `covariances`."""
        return np.asarray(covariances(self.sums[k : k + 1], np.array([shared_by]), sigma_m)[0])


def covariances(sums: Array, shared_by: Array, sigma_m: float) -> Array:
    """(m, 3, 3) of the errors of (x, y, theta) of aligned pairs with `sums` (m, SUMS), axes of the targets.

    `shared_by` (m,) is the number of scans that share the information, at least 2, and `sigma_m` the least sigma of a
    return. A scan of m links has the information of its returns once: against a map of m scans, whose points have
    1 / m of its variance, that is m / (m + 1) of what a map without noise would give, and m + 1 share it. The
    residuals themselves give their variance. What the noise of the normals adds to the Hessian is no information:
    along a corridor it would feign some, as would a few wrong partners at the edges of doors: a direction of which only
    so many returns tell is not observed. What the residuals have beyond the noise of the laser is shape, common to
    neighbouring returns: a part of it stays in the pose, however many returns there are.
    """
    noise = 2.0 * sigma_m**2
    variance = np.maximum(sums[:, SQUARES] / np.maximum(sums[:, WEIGHT], 1.0), noise)
    floor = _SHAPE_SHARE**2 * (variance - noise) + _FLOOR_M**2
    # Both ways the returns of a pair are counted twice.
    upper = sums[:, HESSIAN : HESSIAN + 6] - sums[:, SPREAD : SPREAD + 6]
    returns, axes = np.linalg.eigh(0.5 * upper[:, _SYMMETRIC])
    share = 2.0 / (np.maximum(shared_by, 2.0) * variance)
    values = share[:, None] * np.maximum(returns - _FEW_RETURNS, 0.0)
    spread = 1.0 / np.maximum(values, _UNOBSERVED**-2)
    shape = floor[:, None, None] * np.diag([1.0, 1.0, _LEVER_M**-2])
    return np.asarray((axes * spread[:, None, :]) @ axes.transpose(0, 2, 1) + shape)


def align_pairs(
    returns: Returns, targets: NDArray[np.int64], sources: NDArray[np.int64], starts: Array, gates_m: Array
) -> Alignments:
    """Align pairs of scans from the relative poses `starts` (m, 3), and compare their views."""
    m = len(targets)
    poses, sums, views = starts.copy(), np.zeros((m, SUMS)), np.zeros((m, 2, 3), dtype=np.int64)
    _align_all(returns, targets, sources, gates_m, poses, sums, views)
    return Alignments(targets, sources, poses, sums, views)


@numba.njit(cache=True, error_model="numpy")
def _align_all(
    returns: Returns,
    targets: NDArray[np.int64],
    sources: NDArray[np.int64],
    gates_m: Array,
    poses: Array,
    sums: Array,
    views: NDArray[np.int64],
) -> None:
    for k in range(len(targets)):
        _align(returns, targets[k], sources[k], gates_m, poses[k], sums[k], views[k])
        poses[k, 2] = wrapped(poses[k, 2])


@numba.njit(cache=True, error_model="numpy")
def _align(
    returns: Returns, target: int, source: int, gates_m: Array, pose: Array, sums: Array, views: NDArray[np.int64]
) -> None:
    """Gauss-Newton steps from and into `pose` (3,); fills `sums` (SUMS,) and `views` (2, 3) at its end."""
    start = pose.copy()
    step = 0
    while step < len(gates_m):
        sums[:] = 0.0
        add_both_ways(returns, target, source, pose, Loss(gates_m[step], _SCALE_M), sums)
        if sums[HITS] < _LEAST_HITS:
            return
        hessian, gradient = matrix(sums, HESSIAN), np.empty(3)
        for i in range(3):
            hessian[i, i] += _ANCHOR
            gradient[i] = -(sums[GRADIENT + i] + _ANCHOR * (pose[i] - start[i]))
        move = solved(hessian, gradient)
        pose += move
        shift, turn = abs(move[0]) + abs(move[1]), abs(move[2])
        if gates_m[step] == gates_m[-1] and shift < _STEP_M and turn < _STEP_RAD:
            break
        step = next_step(step, gates_m, shift, turn)
    views[0, 0], views[0, 1], views[0, 2] = compare_views(returns, target, source, pose)
    views[1, 0], views[1, 1], views[1, 2] = compare_views(returns, source, target, inverse(pose))
