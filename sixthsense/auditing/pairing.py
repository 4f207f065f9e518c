"""An estimate beside the truth: the same instants, the same frame, the errors with their covariances and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sixthsense.auditing.poses import ROWS, Frame, Poses, Stamps, axes, interpolated, same_space, turned
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds
from sixthsense.evaluation.metrics import has_full_rank, squares

Align = Literal["none", "all"]
Motion = tuple[Rotation, Array]
"""rotation and shift (3,): x -> R x + t"""
STILL: Motion = Rotation.identity(), np.zeros(3)
"""the motion of an estimate that is in the frame of the truth"""

_GAP = 3.0
"""Longest time between two true poses that are interpolated, in median intervals: beyond it some are missing."""
_BENT = 0.5
"""of the stated sigmas: the error of an interpolated truth beyond which only poses beside a true one are compared"""
_MOST_STEPS = 20
"""of the search for an alignment"""
_SAME = 1e-9
"""Metres and radians; an estimate that is nowhere farther from the truth is the truth."""


@dataclass(frozen=True, slots=True)
class Pair:
    """An estimate and the truth at the same N instants; what was left out is said in the notes."""

    estimate: Poses
    """with covariances of full rank, in the axes of `estimate.frame`"""
    truth: Poses
    """of the same stamps; with covariances where it is another estimate"""
    notes: tuple[str, ...] = ()
    """what the user should know, a line each"""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of N poses in the axes of the world, with the covariances that the estimate states."""

    stamps_ns: NDArray[np.int64]
    """(N,)"""
    error: Array
    """(N, d) estimate minus truth, translation first, the rotation as a vector"""
    cov: Array
    """(N, d, d)"""
    turns: Rotation
    """N estimated ones, from the axes of the body to those of the world"""
    of_estimate: Array | None = None
    """(N, d, d) part of the covariance that is the estimate's own: another estimate has one, too"""

    @property
    def nees(self) -> Array:
        """(N,)."""
        return squares(self.error, self.cov)

    def in_axes(self, frame: Frame) -> tuple[Array, Array]:
        """Errors (N, d) and covariances (N, d, d) in the axes of the world or of the body."""
        if frame == "world":
            return self.error, self.cov
        back = self.turns.inv()
        return (axes(back, len(self.cov[0])) @ self.error[:, :, None])[:, :, 0], turned(self.cov, back)


def paired(estimate: Poses, truth: Poses) -> Pair:
    """The estimate at the instants between true poses, with the truth interpolated there.

    Poses whose covariance has no full rank are left out, since their NEES is not defined, and those in a gap of the
    truth; where the truth bends between its poses by more than the stated sigmas allow, all but those beside a true
    pose. Raises InputError if nothing is left.
    """
    estimate, truth, notes = same_space(estimate, truth)
    notes = [*estimate.notes, *truth.notes, *notes]
    assert estimate.covs is not None
    at, true_ns = estimate.stamps_ns, truth.stamps_ns
    inside = (at >= true_ns[0]) & (at <= true_ns[-1])
    if len(truth) < 2 or not inside.any():
        spans = [f"{one.name} from {seconds(one.stamps_ns[0]):.3f} to {seconds(one.stamps_ns[-1]):.3f} s"
                 for one in (estimate, truth)]  # fmt: skip
        allowed = "one clock, and times that overlap; or `same_start` if both begin together"
        raise InputError("stamps", f"found {' and '.join(spans)}", allowed)
    after = np.clip(np.searchsorted(true_ns, at), 1, len(truth) - 1)
    is_later = at - true_ns[after - 1] > true_ns[after] - at
    nearest, gaps = np.where(is_later, after, after - 1), np.diff(true_ns)
    known = inside & ((gaps[after - 1] <= _GAP * np.median(gaps)) | (true_ns[nearest] == at))
    defined = has_full_rank(estimate.covs)
    if truth.covs is not None:
        defined &= has_full_rank(truth.covs[nearest])
    used = known & defined
    for count, why in (
        (int(np.sum(~inside)), "before or after the truth"),
        (int(np.sum(inside & ~known)), "in a gap of the truth"),
        (int(np.sum(known & ~defined)), "with a covariance that is zero or singular, whose NEES is not defined"),
    ):
        notes += [f"left out: {count:,} of {len(estimate):,} poses {why}"] if count else []
    variances = estimate.covs[used][:, (0, 1), (0, 1)]
    if used.any() and (bend_m := _bend(truth)) > _BENT * float(np.sqrt(np.median(variances))):
        beside = _beside(at, true_ns, nearest, used)
        note = f"the truth bends by {bend_m:.2g} m between its poses, every {seconds(np.median(gaps)):.3g} s"
        if beside.any():
            used = beside
            note += f": only the {int(beside.sum()):,} poses beside a true one are compared"
        notes.append(note)
    if not used.any():
        found = "found no pose beside the truth whose covariance has full rank"
        allowed = f"covariances of {'x, y and heading' if estimate.is_planar else 'all six axes'}"
        raise InputError(estimate.name, found, allowed)
    positions, turns = interpolated(truth, at[used])
    covs = None if truth.covs is None else truth.covs[nearest[used]]
    there = replace(truth, stamps_ns=at[used], positions=positions, turns=turns, covs=covs)
    return Pair(estimate.part(used), there, tuple(notes))


def _bend(truth: Poses) -> float:
    """By how much the way between two true poses leaves the line between them, metres, root mean square.

    It grows with the square of the interval: a quarter of what a true pose is off the line between its neighbours.
    """
    if len(truth) < 3:
        return 0.0
    inner, _ = interpolated(truth.part(np.arange(len(truth)) % 2 == 0), truth.stamps_ns[1:-1:2])
    return 0.25 * float(np.sqrt(np.mean(np.sum((inner - truth.positions[1:-1:2]) ** 2, axis=1))))


def _beside(at: Stamps, true_ns: Stamps, nearest: NDArray[np.int64], used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) the used pose nearest to each true one, closer than a twentieth of the interval."""
    off = np.where(used, np.abs(at - true_ns[nearest]), np.iinfo(np.int64).max)
    order = np.lexsort((off, nearest))
    first = order[np.flatnonzero(np.diff(nearest[order], prepend=-1))]
    kept = np.zeros(len(at), dtype=np.bool_)
    kept[first] = used[first] & (off[first] <= 0.05 * np.median(np.diff(true_ns)))
    return kept


def aligned(pair: Pair, align: Align, frame: Frame) -> Motion:
    """The motion of the estimate onto the truth: none, or that with the least sum of NEES, by Gauss-Newton."""
    if align == "none":
        return STILL
    turn = pair.truth.turns[0] * pair.estimate.turns[0].inv()
    shift = pair.truth.positions[0] - turn.apply(pair.estimate.positions[0])
    for _ in range(_MOST_STEPS):
        found = errors_of(pair, (turn, shift), frame)
        places = turn.apply(pair.estimate.positions) + shift
        centre = places.mean(axis=0)
        rows = ROWS[found.error.shape[1]]
        carry = np.tile(np.eye(6), (len(places), 1, 1))  # a step of the motion about the centre to each pose
        carry[:, :3, 3:] = np.cross(np.eye(3), (places - centre)[:, None]).transpose(0, 2, 1)
        carry = carry[:, rows][:, :, rows]
        weighted = np.linalg.solve(found.cov, np.concatenate([carry, found.error[:, :, None]], axis=2))
        sums = np.einsum("kij,kil->jl", carry, weighted)
        step = np.zeros(6)
        step[rows] = -np.linalg.solve(sums[:, :-1], sums[:, -1])
        by = Rotation.from_rotvec(step[3:])
        turn, shift = by * turn, by.apply(shift - centre) + centre + step[:3]
        if step[rows] @ sums[:, :-1] @ step[rows] < 1e-8:  # squared, in sigmas of the alignment
            break
    return turn, shift


def check_is_not_the_truth(pair: Pair) -> None:
    """Raise InputError for an estimate without errors: somebody has given the same poses twice."""
    if np.abs(errors_of(pair, STILL, "world").error).max() <= _SAME:
        raise InputError("truth", f"found the poses of the estimate, {pair.estimate.name}", "the true ones")


def errors_of(pair: Pair, motion: Motion, frame: Frame) -> Errors:
    """The errors of the estimate after a motion, with its covariances read in the axes of `frame`.

    They are in the axes of the truth's world: the rotation's is the vector of R_estimate R_truth^T.
    """
    turn, shift = motion
    estimate, truth, covs = pair.estimate, pair.truth, pair.estimate.covs
    assert covs is not None
    turns = turn * estimate.turns
    places = turn.apply(estimate.positions) + shift - truth.positions
    error = np.column_stack([places, (turns * truth.turns.inv()).as_rotvec()])[:, ROWS[covs.shape[1]]]
    cov = own = turned(covs, turns if frame == "body" else turn)
    if truth.covs is not None:
        cov = own + (turned(truth.covs, truth.turns) if truth.frame == "body" else truth.covs)
    return Errors(estimate.stamps_ns, error, cov, turns, of_estimate=own)


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
