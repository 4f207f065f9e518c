"""Proper scores of stated covariances, and errors of trajectories as evo has them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from sixthsense.auditing import rotations
from sixthsense.auditing.pairing import Errors, Pair
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.effective import effective_number, whitened_errors
from sixthsense.evaluation.metrics import squares

LEVELS = (0.5, 0.9, 0.95)
"""of the regions whose coverage is told"""


@dataclass(frozen=True, slots=True)
class Score:
    """How well a stated covariance describes errors: of the whole pose, the position, or the rotation."""

    coverage: dict[float, float]
    """share of the errors inside the region that is to hold this share"""
    intervals: dict[float, tuple[float, float]]
    """95 % of each share, by the effective number of samples (Wilson)"""
    samples: float
    """effective number of samples"""
    log_score: float
    """mean of the negative logarithm of the stated density at the errors, nats (m, rad): less is better"""
    scaled_log_score: float
    """the same if the covariance were multiplied by its factor, the least that any multiple has"""


def scores(runs: Sequence[Errors]) -> dict[str, Score]:
    """The scores of runs that are independent of each other, of the `pose`, its `position` and its `rotation`."""
    dof, n = runs[0].error.shape[1], runs[0].orientations.shape[1]
    parts = {"pose": slice(0, dof), "position": slice(0, n), "rotation": slice(n, dof)}
    return {
        name: _score([(run.error[:, part], run.cov[:, part, part]) for run in runs]) for name, part in parts.items()
    }


def _score(runs: Sequence[tuple[Array, Array]]) -> Score:
    dof = runs[0][0].shape[1]
    each = [squares(error, cov) for error, cov in runs]
    samples = effective_number(each, [whitened_errors(error, cov) for error, cov in runs])
    nees = np.concatenate(each)
    coverage = {level: float(np.mean(nees <= chi_square_quantile(level, dof))) for level in LEVELS}
    volumes = np.concatenate([np.linalg.slogdet(cov)[1] for _, cov in runs])
    volume = dof * math.log(2.0 * math.pi) + float(volumes.mean())
    mean = float(nees.mean())
    scaled = 0.5 * (volume + dof * math.log(max(mean / dof, 1e-300)) + dof)
    intervals = {level: _wilson(share, samples) for level, share in coverage.items()}
    return Score(coverage, intervals, samples, 0.5 * (volume + mean), scaled)


def _wilson(share: float, samples: float, z: float = 1.96) -> tuple[float, float]:
    """The interval of a share of so many independent samples. Wilson, JASA 22, 1927."""
    spread = z * math.sqrt(share * (1.0 - share) / samples + (0.5 * z / samples) ** 2)
    middle, scale = share + 0.5 * z**2 / samples, 1.0 + z**2 / samples
    return max(0.0, (middle - spread) / scale), min(1.0, (middle + spread) / scale)


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Errors of a trajectory without its covariances, as evo tells them."""

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
    ate = _rms(np.linalg.norm(found.positions - true.positions, axis=1))
    turn, shift = fitted(found.positions, true.positions)
    aligned = _rms(np.linalg.norm(found.positions @ turn.T + shift - true.positions, axis=1))
    if len(found) < 2:
        return TrajectoryErrors(ate, aligned, math.nan, math.nan)
    turns, steps = [], []
    for poses in (true, found):
        back = rotations.transposed(poses.orientations[:-1])
        turns.append(back @ poses.orientations[1:])
        steps.append((back @ np.diff(poses.positions, axis=0)[:, :, None])[:, :, 0])
    angles = np.linalg.norm(rotations.log(rotations.transposed(turns[0]) @ turns[1]), axis=1)
    return TrajectoryErrors(ate, aligned, _rms(np.linalg.norm(steps[1] - steps[0], axis=1)), math.degrees(_rms(angles)))


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


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
