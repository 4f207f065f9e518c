"""An estimate beside the truth: the same instants, the same frame, and the errors with their covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sixthsense.auditing import rotations
from sixthsense.auditing.poses import Frame, Poses, Stamps, interpolated, is_of_plane, tilted
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds
from sixthsense.evaluation.metrics import has_full_rank, squares

Align = Literal["none", "all"]
Motion = tuple[Array, Array]
"""rotation (n, n) and shift (n,): x -> R x + t"""

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
    orientations: Array
    """(N, n, n) estimated, from the axes of the body to those of the world"""
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
        axes = rotations.transposed(rotations.axes(self.orientations))
        return (axes @ self.error[:, :, None])[:, :, 0], axes @ self.cov @ rotations.transposed(axes)


def same_space(estimate: Poses, truth: Poses) -> tuple[Poses, Poses, list[str]]:
    """Both in the plane or both in space, and a note that says why it is the plane."""
    reason = is_of_plane(estimate) or (is_of_plane(truth) if truth.covs is not None else "")
    if not reason and truth.is_planar:
        reason = "the truth is planar"
    if not reason:
        return estimate, truth, []
    note = [] if estimate.is_planar else [f"audited as SE(2), x, y and heading: {reason}"]
    for one in (estimate, truth):
        note += [] if one.is_planar else tilted(one.name, one.orientations)
    return estimate.in_plane(), truth.in_plane(), note


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
        spans = [f"{seconds(one[0]):.3f} to {seconds(one[-1]):.3f} s" for one in (at, true_ns)]
        raise InputError(
            "stamps",
            f"found {estimate.name} from {spans[0]} and {truth.name} from {spans[1]}",
            "one clock, and times that overlap; or `same_start` if both begin together",
        )
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
    if used.any() and (bend_m := _bend(truth)) > _BENT * _sigma(estimate.covs[used]):
        beside = _beside(at, true_ns, nearest, used)
        note = f"the truth bends by {bend_m:.2g} m between its poses, every {seconds(np.median(gaps)):.3g} s"
        if beside.any():
            used = beside
            note += f": only the {int(beside.sum()):,} poses beside a true one are compared"
        notes.append(note)
    if not used.any():
        raise InputError(
            estimate.name,
            "found no pose beside the truth whose covariance has full rank",
            f"covariances of {'x, y and heading' if estimate.is_planar else 'all six axes'}",
        )
    positions, orientations = interpolated(truth, at[used])
    covs = None if truth.covs is None else truth.covs[nearest[used]]
    there = replace(truth, stamps_ns=at[used], positions=positions, orientations=orientations, covs=covs)
    return Pair(estimate.part(used), there, tuple(notes))


def _bend(truth: Poses) -> float:
    """By how much the way between two true poses leaves the line between them, metres, root mean square.

    It grows with the square of the interval: a quarter of what a true pose is off the line between its neighbours.
    """
    if len(truth) < 3:
        return 0.0
    inner, _ = interpolated(truth.part(np.arange(len(truth)) % 2 == 0), truth.stamps_ns[1:-1:2])
    return 0.25 * float(np.sqrt(np.mean(np.sum((inner - truth.positions[1:-1:2]) ** 2, axis=1))))


def _sigma(covs: Array) -> float:
    """Median of the stated sigma of a position's coordinate, metres."""
    return float(np.sqrt(np.median(covs[:, (0, 1), (0, 1)])))


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
    n = pair.truth.positions.shape[1]
    if align == "none":
        return np.eye(n), np.zeros(n)
    turn = pair.truth.orientations[0] @ pair.estimate.orientations[0].T
    shift = pair.truth.positions[0] - turn @ pair.estimate.positions[0]
    for _ in range(_MOST_STEPS):
        found = errors_of(pair, (turn, shift), frame)
        places = pair.estimate.positions @ turn.T + shift
        centre = places.mean(axis=0)
        carry = rotations.levers(places - centre)
        weighted = np.linalg.solve(found.cov, np.concatenate([carry, found.error[:, :, None]], axis=2))
        sums = np.einsum("kij,kil->jl", carry, weighted)
        step = -np.linalg.solve(sums[:, :-1], sums[:, -1])
        by = rotations.exp(step[None, n:])[0]
        turn, shift = by @ turn, by @ (shift - centre) + centre + step[:n]
        if step @ sums[:, :-1] @ step < 1e-8:  # squared, in sigmas of the alignment
            break
    return turn, shift


def check_is_not_the_truth(pair: Pair) -> None:
    """Raise InputError for an estimate without errors: somebody has given the same poses twice."""
    n = pair.truth.positions.shape[1]
    if np.abs(errors_of(pair, (np.eye(n), np.zeros(n)), "world").error).max() <= _SAME:
        raise InputError("truth", f"found the poses of the estimate, {pair.estimate.name}", "the true ones")


def errors_of(pair: Pair, motion: Motion, frame: Frame) -> Errors:
    """The errors of the estimate after a motion, with its covariances read in the axes of `frame`.

    They are in the axes of the truth's world: the rotation's is the vector of R_estimate R_truth^T.
    """
    turn, shift = motion
    estimate, covs = pair.estimate, pair.estimate.covs
    assert covs is not None
    orientations = turn @ estimate.orientations
    places = estimate.positions @ turn.T + shift - pair.truth.positions
    turned = rotations.log(orientations @ rotations.transposed(pair.truth.orientations))
    axes = rotations.axes(orientations if frame == "body" else turn[None])
    cov = own = axes @ covs @ rotations.transposed(axes)
    if pair.truth.covs is not None:
        beside = rotations.axes(pair.truth.orientations if pair.truth.frame == "body" else np.eye(len(shift))[None])
        cov = own + beside @ pair.truth.covs @ rotations.transposed(beside)
    return Errors(estimate.stamps_ns, np.concatenate([places, turned], axis=1), cov, orientations, of_estimate=own)
