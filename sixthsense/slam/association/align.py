"""Where the robot is by the walls alone: a scan's walls laid onto the map's, to choose matches and for nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from sixthsense.config import AlignConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Sighting
from sixthsense.slam.association.walls import ends
from sixthsense.slam.estimators.base import Estimate

_SLACK_M = 0.1  # sigma of the predicted position that is assumed at least: the map is not certain either
_SLACK_RAD = 0.05


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where the walls of a scan fit those of the map best."""

    pose: Pose
    """world frame"""
    explained: float
    """share, 0 to 1, of the sighted walls' length that lies on known walls from there"""


def align(
    sightings: Sequence[Sighting], estimate: Estimate, extents: Array, gap_m: float, cfg: AlignConfig
) -> Alignment:
    """Lay the walls among `sightings` onto those of the estimate, whose extents are (n, 2, 2), from several headings.

    Robust Gauss-Newton steps over the offsets of both ends of each wall from the wall nearest to it, held by the
    predicted pose and its covariance. Other headings are tried where the predicted one leaves much unexplained, and
    win only by explaining clearly more. With no wall, or no known one, the predicted pose comes back as it is.
    """
    sighted = [s for s in sightings if s.is_wall]
    known = np.flatnonzero(estimate.walls)
    if not sighted or not len(known):
        return Alignment(estimate.pose, 0.0)
    pieces = np.array([ends(Pose(), s) for s in sighted])
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
        _laid(pieces, found, walls, 2.0 * cfg.scale_m, cfg.reach_rad, gap_m, rows)
        on = np.abs(rows[:, :, 0]).max(axis=1) <= 2.0 * cfg.scale_m  # not so for the NaN of a piece on no wall
        share = float(lengths[on].sum() / lengths.sum())
        if share > best_share + (cfg.margin if best_share >= 0.0 else 0.0):
            best, best_share = found, share
    return Alignment(Pose(best[0], best[1], wrap_angle(best[2])), best_share)


def _lines(walls: Array, extents: Array) -> Array:
    """(n, 5) unit normal, distance, and from where to where along it, of walls (n, 2) with their extents (n, 2, 2)."""
    normal = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    reach = np.einsum("nek,nk->ne", extents, np.column_stack([-normal[:, 1], normal[:, 0]]))
    return np.column_stack([normal, walls[:, 1], reach.min(axis=1), reach.max(axis=1)])


def _fit(
    pieces: Array, walls: Array, begin: Array, predicted: Array, information: Array, gap_m: float, cfg: AlignConfig
) -> Array:
    """The pose (3,) at which `pieces` (m, 2, 2), robot's frame, lie on `walls` (n, 5), from `begin` on.

    Gauss-Newton on the offsets of the pieces' ends under a Cauchy loss; each piece is of the wall nearest to it then.
    """
    pose, rows = begin.copy(), np.empty((len(pieces), 2, 4))
    for _ in range(cfg.steps):
        _laid(pieces, pose, walls, cfg.reach_m, cfg.reach_rad, gap_m, rows)
        laid = rows[~np.isnan(rows[:, 0, 0])].reshape(-1, 4)
        residual, jacobian = laid[:, 0], laid[:, 1:]
        weighted = jacobian / (cfg.scale_m**2 + residual**2)[:, None]
        off = pose - predicted
        off[2] = wrap_angle(off[2])
        pose = pose - np.linalg.solve(information + weighted.T @ jacobian, information @ off + weighted.T @ residual)
    return pose


@numba.njit(cache=True, error_model="numpy")
def _nearest(
    ax: float, ay: float, bx: float, by: float, walls: Array, reach_m: float, reach_rad: float, gap_m: float
) -> int:
    """The row of `walls` (n, 5: unit normal, d, from where to where) nearest to a piece from a to b; -1 if none is.

    All in the world frame; a piece runs so that its wall's normal lies a quarter turn clockwise of it.
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
def _laid(
    pieces: Array, pose: Array, walls: Array, reach_m: float, reach_rad: float, gap_m: float, rows: Array
) -> None:
    """Fill `rows` (m, 2, 4) with residual and its Jacobian by the pose for both ends of each piece, NaN for none."""
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
