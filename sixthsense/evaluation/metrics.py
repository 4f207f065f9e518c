"""Metrics of trajectories and landmarks as functions of arrays.

Poses are rows (x, y, theta), metres and radians. The error of an estimate is estimate minus truth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmark_kernels import innovations_of
from sixthsense.core.se2 import between
from sixthsense.logs.log import matched


def ate(estimate: Array, truth: Array) -> float:
    """Absolute trajectory error, unaligned: RMSE of the position error, metres.

    `estimate`, `truth` (N, 3), or (N, 2), at the same instants, N at least 1.
    """
    return float(np.sqrt(np.mean(np.sum((estimate[:, :2] - truth[:, :2]) ** 2, axis=1))))


def heading_rmse(estimate: Array, truth: Array) -> float:
    """RMSE of the heading, radians, of (N, 3) poses at the same instants."""
    return float(np.sqrt(np.mean(wrap_angle(estimate[:, 2] - truth[:, 2]) ** 2)))


RPE_LENGTHS_M = (1, 2, 5, 10)
"""lengths of path over which the relative pose error is measured"""
_RPE_TOLERANCE = 0.1  # a pair may be this share of the length longer or shorter, as in evo


def relative_pose_errors(estimate: Array, truth: Array, length_m: float) -> tuple[Array, Array]:
    """Errors of the motion over every sub-trajectory of a length: translations (P,), m, and rotations (P,), rad.

    `estimate`, `truth` (N, 3) at the same instants. From each pose on it is the sub-trajectory to the pose whose
    distance along the true path comes nearest to `length_m`, and none if that is off by more than a tenth. Both errors
    are magnitudes, of inverse(true motion) ∘ (estimated motion). Geiger et al., CVPR 2012 (KITTI); evo's RPE with all
    pairs, taken from the reference.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    first = np.arange(len(truth) - 1)
    beyond = np.clip(np.searchsorted(along, along[:-1] + length_m), first + 1, len(truth) - 1)
    # Of the poses at which the robot stands still, the first.
    short_of = np.maximum(np.searchsorted(along, along[beyond - 1]), first + 1)
    off = np.abs(along[[short_of, beyond]] - along[:-1] - length_m)
    last, off = np.where(off[0] <= off[1], short_of, beyond), off.min(axis=0)
    first, last = first[off <= _RPE_TOLERANCE * length_m], last[off <= _RPE_TOLERANCE * length_m]
    error = between(between(truth[first], truth[last]), between(estimate[first], estimate[last]))
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def nees_world(error: Array, cov: Array) -> Array:
    """Normalised estimation error squared in world coordinates, (K,): 3 on average for a consistent filter.

    `error` (K, 3) estimate minus truth, heading wrapped here; `cov` (K, 3, 3) of the same, full rank (LinAlgError, a
    ValueError, if singular). Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    return squares(np.column_stack([error[:, :2], wrap_angle(error[:, 2])]), cov)


def squares(error: Array, cov: Array) -> Array:
    """(K,) squared Mahalanobis lengths of (K, d) errors with (K, d, d) covariances of full rank."""
    return np.asarray(np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0]))


def nees_invariant(estimate: Array, truth: Array, cov_world: Array) -> Array:
    """NEES of the right-invariant error, (K,), in which a heading error also rotates the position error.

    `estimate`, `truth` (K, 3); `cov_world` (K, 3, 3) of the world-frame error, full rank. With X = [R p; 0 1] in SE(2)
    the right-invariant error is xi = log(X_hat X^-1) (Barrau and Bonnabel 2017). To first order
    X_hat = exp(xi) X gives

        p_hat - p = xi_p + xi_theta J p_hat,   theta_hat - theta = xi_theta,   J = [0 -1; 1 0],

    so that e = A xi, with A = [I, J p_hat; 0, 1] at the estimate, turns xi into world-frame coordinates, the covariance
    of xi is A^-1 cov A^-T, and the NEES xi^T (A^-1 cov A^-T)^-1 xi is (A xi)^T cov^-1 (A xi). A xi does not depend on
    where the origin lies: put it at p_hat, and A = I. With d = theta_hat - theta the translation of X_hat X^-1 is then
    R(d) (p_hat - p), and the V(d) of the exponential is R(d/2) sin(d/2) / (d/2), so that exactly

        A xi = (R(d/2) (p_hat - p) (d/2) / sin(d/2), d).
    """
    turn = wrap_angle(estimate[:, 2] - truth[:, 2])
    half = 0.5 * turn
    c, s = np.cos(half), np.sin(half)
    dx, dy = (estimate[:, :2] - truth[:, :2]).T
    stretch = 1.0 / np.sinc(half / np.pi)  # numpy's sinc(x) is sin(pi x) / (pi x)
    return nees_world(np.column_stack([stretch * (c * dx - s * dy), stretch * (s * dx + c * dy), turn]), cov_world)


def nees_landmarks(estimate: Array, truth: Array, walls: NDArray[np.bool_], cov: Array) -> Array:
    """NEES of landmarks, each for itself, (M,): 2 on average for a consistent estimator.

    `estimate`, `truth` (M, 2) world frame; of those marked in `walls` (M,) the first column is an angle, and its error
    is wrapped; `cov` (M, 2, 2) full rank. Landmarks of one run share errors, so these are not independent samples.
    """
    return squares(*innovations_of(estimate, cov, truth, walls))


def full_rank_from(cov: Array) -> int:
    """The first index from which NEES is defined: `cov` (K, 3, 3) has full rank there; K if it never has."""
    full = has_full_rank(cov)
    return int(np.argmax(full)) if full.any() else len(cov)


def has_full_rank(cov: Array) -> NDArray[np.bool_]:
    """(K,) whether NEES is defined: each of `cov` (K, d, d) has full rank.

    The rank is that of the correlation matrix, since metres and radians are not comparable. The floor of a micrometre
    that a smoother adds to an exact start does not count.
    """
    variances = np.einsum("kii->ki", cov)
    positive = np.all(variances > 0.0, axis=1)
    sigmas = np.sqrt(np.where(positive[:, None], variances, 1.0))
    correlation = cov / (sigmas[:, :, None] * sigmas[:, None, :])
    return np.asarray(positive & (np.linalg.eigvalsh(correlation)[:, 0] > 1e-7))


def nees_band(runs: float, dof: int = 3, confidence: float = 0.95) -> tuple[float, float]:
    """The two-sided confidence band of the mean of `runs` independent NEES with `dof` degrees of freedom.

    `runs` may be an effective number of samples, which need not be whole. 2.02-4.16 for 20
    runs, 2.36-3.72 for 50. Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    tail = 0.5 * (1.0 - confidence)
    low, high = (float(chi_square_quantile(share, dof * runs)) / runs for share in (tail, 1.0 - tail))
    return low, high


def relations_error(
    stamps_s: Array, poses: Array, relations_stamps: Array, relations_poses: Array
) -> tuple[Array, Array]:
    """Errors of a trajectory against reference relative poses: translations (R,), m, and rotations (R,), rad.

    `stamps_s` (N,) seconds in any order and `poses` (N, 3), one per scan; `relations_stamps` (R, 2) and
    `relations_poses` (R, 3), the robot at t2 in its frame at t1. Both errors are magnitudes. Raises ValueError for a
    relation without a scan within half a period. Kümmerle et al., Autonomous Robots 27(4), 2009: the error is
    inverse(relation) ∘ (inverse(x_t1) ∘ x_t2).
    """
    rows = matched(stamps_s, relations_stamps)
    if (rows < 0).any():
        row, column = np.argwhere(rows < 0)[0]
        raise ValueError(f"relation {row + 1} names {relations_stamps[row, column]:.6f}: no scan has that stamp")
    first, second = poses[rows].transpose(1, 0, 2)
    error = between(relations_poses, between(first, second))
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def match_landmarks(estimated: Array, truth: Array, radius: float) -> tuple[float, int]:
    """RMSE and number of one-to-one matches of (N, 2) estimated and (M, 2) true points, metres.

    The assignment has the most matches within `radius`, and among these the least squared distances. The RMSE is NaN
    without a match.
    """
    from scipy.optimize import linear_sum_assignment  # here, since it takes a while to load

    squared = np.sum((estimated[:, None] - truth[None]) ** 2, axis=2)  # (N, M)
    # To have no match costs more than all matches, so their number comes first.
    costs = np.where(squared <= radius**2, squared, 1.0 + radius**2 * (1 + min(squared.shape)))
    found = squared[linear_sum_assignment(costs)]
    found = found[found <= radius**2]
    return (float(np.sqrt(found.mean())) if len(found) else math.nan), len(found)


def true_landmarks(walls: Array, tolerance_m: float = 1e-3) -> Array:
    """The corners and free ends (M, 2) of `walls` (N, 2, 2), metres.

    These are the ends of walls and the points where walls cross or meet, except where a wall only continues in a
    straight line. Points closer than `tolerance_m` are merged.
    """
    from scipy.spatial import cKDTree  # here, since it takes a while to load

    walls = walls[np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1) > 2.0 * tolerance_m]
    if len(walls) == 0:
        return np.empty((0, 2))
    candidates = np.concatenate([walls.reshape(-1, 2), *(_crossings(w, walls[i + 1 :]) for i, w in enumerate(walls))])
    candidates = np.unique(candidates, axis=0)
    is_new = np.ones(len(candidates), dtype=np.bool_)
    is_new[cKDTree(candidates).query_pairs(tolerance_m, output_type="ndarray")[:, 1]] = False
    along = walls[:, 1] - walls[:, 0]
    lengths, angles = np.hypot(*along.T), np.arctan2(along[:, 1], along[:, 0])
    along /= lengths[:, None]

    def is_bend(point: Array) -> bool:
        """Whether the directions of the walls that leave a point are not exactly the two of one straight line."""
        offset = point - walls[:, 0]
        t, off = (offset * along).sum(axis=1), offset[:, 1] * along[:, 0] - offset[:, 0] * along[:, 1]
        on_it = (np.abs(off) <= tolerance_m) & (t >= -tolerance_m) & (t <= lengths + tolerance_m)
        onward, backward = on_it & (t < lengths - tolerance_m), on_it & (t > tolerance_m)
        directions = np.concatenate([angles[onward], angles[backward] + math.pi])
        turns = np.abs(wrap_angle(directions - directions[0]))
        ahead, behind = turns < 1e-3, turns > math.pi - 1e-3
        return not (np.all(ahead | behind) and behind.any())

    return np.array([point for point in candidates[is_new] if is_bend(point)]).reshape(-1, 2)


def _crossings(wall: Array, others: Array) -> Array:
    """(K, 2) points where a wall (2, 2) crosses the others (N, 2, 2), without parallel ones."""
    d, e = wall[1] - wall[0], others[:, 1] - others[:, 0]
    gap = others[:, 0] - wall[0]
    cross = d[0] * e[:, 1] - d[1] * e[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (gap[:, 0] * e[:, 1] - gap[:, 1] * e[:, 0]) / cross
        u = (gap[:, 0] * d[1] - gap[:, 1] * d[0]) / cross
    parallel = np.abs(cross) <= 1e-9 * np.linalg.norm(d) * np.linalg.norm(e, axis=1)
    hit = ~parallel & (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    return np.asarray(wall[0] + t[hit, None] * d)
