"""Errors of trajectories without covariances, as evo has them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from sixthsense.auditing import rotations
from sixthsense.auditing.pairing import Pair
from sixthsense.core.geometry import Array


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Errors of a trajectory without its covariances."""

    ate_m: float
    """RMSE of the position, as the poses stand (`evo_ape`)"""
    aligned_ate_m: float
    """the same after the rigid motion with the least sum of squares (`evo_ape --align`)"""
    rpe_m: float
    """RMSE of the translation of the relative pose error from one pose to the next (`evo_rpe`)"""
    rpe_deg: float
    """RMSE of its angle"""


def trajectory_errors(pair: Pair) -> TrajectoryErrors:
    """The errors of poses beside the truth at the same instants."""
    found, true = pair.estimate, pair.truth
    turn, shift = fitted(found.positions, true.positions)
    ate, aligned = rms(found.positions - true.positions), rms(found.positions @ turn.T + shift - true.positions)
    if len(found) < 2:
        return TrajectoryErrors(ate, aligned, math.nan, math.nan)
    turns, steps = [], []
    for poses in (true, found):
        back = rotations.transposed(poses.orientations[:-1])
        turns.append(back @ poses.orientations[1:])
        steps.append((back @ np.diff(poses.positions, axis=0)[:, :, None])[:, :, 0])
    angles = rotations.log(rotations.transposed(turns[0]) @ turns[1])
    return TrajectoryErrors(ate, aligned, rms(steps[1] - steps[0]), math.degrees(rms(angles)))


def fitted(points: Array, true: Array) -> tuple[Array, Array]:
    """The rigid motion x -> R x + t of (N, n) points onto others with the least sum of squares (Umeyama 1991)."""
    centre, onto = points.mean(axis=0), true.mean(axis=0)
    u, _, vt = np.linalg.svd((true - onto).T @ (points - centre))
    signs = np.ones(len(u))
    signs[-1] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = (u * signs) @ vt
    return turn, onto - turn @ centre


def pooled(runs: Sequence[tuple[int, TrajectoryErrors]]) -> TrajectoryErrors:
    """The errors of several runs together, by their numbers of poses."""
    counts = np.array([count for count, _ in runs], dtype=np.float64)
    values = np.array([astuple(errors) for _, errors in runs])  # (runs, fields)
    return TrajectoryErrors(*np.sqrt(counts @ values**2 / counts.sum()).tolist())


def rms(rows: Array) -> float:
    """Root mean square of the lengths of (N, n) vectors."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
