"""Alignment of a scan's walls with the map's walls; the aligned pose serves to choose matches only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from sixthsense.config import AlignConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Observation
from sixthsense.slam.association.wall_extents import ends
from sixthsense.slam.estimators.base import Estimate

_SLACK_M = 0.1  # added to the predicted pose's sigmas, since the map is uncertain too
_SLACK_RAD = 0.05


@dataclass(frozen=True, slots=True)
class Alignment:
    """The pose at which the walls of a scan fit those of the map best."""

    pose: Pose
    """world frame"""
    explained: float
    """share, 0 to 1, of the observed walls' length that lies on known walls at that pose"""


def align(
    observations: Sequence[Observation], estimate: Estimate, extents: Array, gap_m: float, cfg: AlignConfig
) -> Alignment:
    """Align the walls among `observations` with those of the estimate, whose extents are (n, 2, 2).

    Robust Gauss-Newton minimises the offsets of both ends of each wall from the nearest known wall, with the predicted
    pose and its covariance as prior. Where the predicted heading leaves much unexplained, other initial headings are
    tried; one of them is taken only if it explains clearly more. Without an observed or a known wall the predicted pose
    is returned.
    """
    observed = [s for s in observations if s.is_wall]
    known = np.flatnonzero(estimate.walls)
    if not observed or not len(known):
        return Alignment(estimate.pose, 0.0)
    pieces = np.array([ends(Pose(), s) for s in observed])
    walls = _lines(estimate.landmarks[known], extents[known])
    slack = np.diag([_SLACK_M**2, _SLACK_M**2, _SLACK_RAD**2])
    information = np.asarray(np.linalg.inv(estimate.pose_cov + slack), dtype=np.float64)
    predicted = estimate.pose.array()
    lengths = np.hypot(*(pieces[:, 1] - pieces[:, 0]).T)
    best, best_share, rows = predicted, -1.0, np.empty((len(pieces), 2, 4))
    for turn in (0.0, *(sign * t for t in cfg.headings_rad for sign in (1.0, -1.0))):
        if best_share >= cfg.enough:
            break
        begin = predicted + np.array([0.0, 0.0, turn])
        found = _fit(pieces, walls, begin, predicted, information, gap_m, cfg)
        _residuals(pieces, found, walls, 2.0 * cfg.scale_m, cfg.reach_rad, gap_m, rows)
        on = np.abs(rows[:, :, 0]).max(axis=1) <= 2.0 * cfg.scale_m  # false for the NaN of a piece without a wall
        share = float(lengths[on].sum() / lengths.sum())
        if share > best_share + (cfg.margin if best_share >= 0.0 else 0.0):
            best, best_share = found, share
    return Alignment(Pose(best[0], best[1], wrap_angle(best[2])), best_share)


def _lines(walls: Array, extents: Array) -> Array:
    """(n, 5) unit normal, distance, and first and last place along the line, of walls (n, 2) with extents (n, 2, 2)."""
    normal = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    reach = np.einsum("nek,nk->ne", extents, np.column_stack([-normal[:, 1], normal[:, 0]]))
    return np.column_stack([normal, walls[:, 1], reach.min(axis=1), reach.max(axis=1)])


def _fit(
    pieces: Array, walls: Array, begin: Array, predicted: Array, information: Array, gap_m: float, cfg: AlignConfig
) -> Array:
    """The pose (3,) at which `pieces` (m, 2, 2), robot's frame, lie on `walls` (n, 5), iterated from `begin`.

    Gauss-Newton on the offsets of the pieces' ends under a Cauchy loss; each step pairs a piece with its nearest wall.
    """
    pose, rows = begin.copy(), np.empty((len(pieces), 2, 4))
    for _ in range(cfg.steps):
        _residuals(pieces, pose, walls, cfg.reach_m, cfg.reach_rad, gap_m, rows)
        paired = rows[~np.isnan(rows[:, 0, 0])].reshape(-1, 4)
        residual, jacobian = paired[:, 0], paired[:, 1:]
        weighted = jacobian / (cfg.scale_m**2 + residual**2)[:, None]
        off = pose - predicted
        off[2] = wrap_angle(off[2])
        pose = pose - np.linalg.solve(information + weighted.T @ jacobian, information @ off + weighted.T @ residual)
    return pose


@numba.njit(cache=True, error_model="numpy")
def _nearest(
    ax: float, ay: float, bx: float, by: float, walls: Array, reach_m: float, reach_rad: float, gap_m: float
) -> int:
    """Row of `walls` (n, 5: unit normal, d, first and last place) nearest to a piece from a to b; -1 for none.

    All in the world frame. The wall's normal lies a quarter turn clockwise of the direction from a to b.
    """
    length = math.hypot(bx - ax, by - ay)
    nx, ny = (by - ay) / length, (ax - bx) / length
    parallel = math.cos(reach_rad)
    best, nearest = -1, reach_m
    for j in range(len(walls)):
        c, s = walls[j, 0], walls[j, 1]
        if c * nx + s * ny < parallel:
            continue
        offset = abs(0.5 * (c * (ax + bx) + s * (ay + by)) - walls[j, 2])
        if offset < nearest and max(c * ay - s * ax, walls[j, 3]) - min(c * by - s * bx, walls[j, 4]) < gap_m:
            best, nearest = j, offset
    return best


@numba.njit(cache=True, error_model="numpy")
def _residuals(
    pieces: Array, pose: Array, walls: Array, reach_m: float, reach_rad: float, gap_m: float, rows: Array
) -> None:
    """Fill `rows` (m, 2, 4) with residual and Jacobian by the pose for both ends of each piece; NaN without a wall."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(pieces)):
        ax, ay = c * pieces[k, 0, 0] - s * pieces[k, 0, 1], s * pieces[k, 0, 0] + c * pieces[k, 0, 1]
        bx, by = c * pieces[k, 1, 0] - s * pieces[k, 1, 1], s * pieces[k, 1, 0] + c * pieces[k, 1, 1]
        x, y = pose[0], pose[1]
        j = _nearest(x + ax, y + ay, x + bx, y + by, walls, reach_m, reach_rad, gap_m)
        if j < 0:
            rows[k] = np.nan
            continue
        nx, ny, d = walls[j, 0], walls[j, 1], walls[j, 2]
        rows[k, :, 1], rows[k, :, 2] = nx, ny
        rows[k, 0, 0], rows[k, 0, 3] = nx * (x + ax) + ny * (y + ay) - d, ny * ax - nx * ay
        rows[k, 1, 0], rows[k, 1, 3] = nx * (x + bx) + ny * (y + by) - d, ny * bx - nx * by
