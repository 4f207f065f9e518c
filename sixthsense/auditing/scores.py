"""Errors of trajectories without covariances, as evo has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sixthsense.auditing.pairing import Pair
from sixthsense.core.geometry import Array


class TrajectoryErrors(NamedTuple):
    """Errors of a trajectory without its covariances."""

    ate_m: float
    """RMSE of the position, as the poses stand (`evo_ape`)"""
    aligned_ate_m: float
    """the same after the rigid motion with the least sum of squares (`evo_ape --align`)"""


def trajectory_errors(pair: Pair) -> TrajectoryErrors:
    """The errors of poses beside the truth at the same instants."""
    n = 2 if pair.estimate.is_planar else 3
    found, true = pair.estimate.positions[:, :n], pair.truth.positions[:, :n]
    turn, shift = fitted(found, true)
    return TrajectoryErrors(rms(found - true), rms(found @ turn.T + shift - true))


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
    values = np.array([errors for _, errors in runs])  # (runs, fields)
    return TrajectoryErrors(*np.sqrt(counts @ values**2 / counts.sum()).tolist())


def rms(rows: Array) -> float:
    """Root mean square of the lengths of (N, n) vectors."""
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
