"""The offset between the clocks of scans and odometry, found from the turns that both see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.laser import Scan, sweep_ns

MOST_S = 120.0
"""Largest offset that is searched."""
LEAST_S = 0.08
"""Smaller offsets are those of sensors: what a scan takes, and what a driver waits."""
_PAIRS, _APART_S, _LONGEST_S = 1000, 0.2, 2.0  # pairs of scans that are compared, and the time between the two
_BINS = 180  # of bearings, around a full turn
_SHIFTS = 35  # bins to either side: a robot turns by less from one scan to the next
_FAR_M, _MOST_M = 30.0, 0.5  # ranges beyond are not compared; and by which two ranges differ at most
_FEWEST_BINS = 20  # that both scans of a pair have seen
_CAP_RAD = 0.2  # of an error: the turn of a pair was not seen
_TURN_RAD, _FEWEST_TURNS = 0.05, 10  # a pair turns by more; and pairs without which nothing is sure
_KNOWN = 0.2  # share of the turns during which there must be odometry
_GRID_S = 0.01  # of the headings by odometry
_LONGEST_LOG_S = 1e5
_STEP_S, _FINE_S, _NEAR_S = 0.1, 0.01, 1.0  # of the search, and of that around its best offset
_EXPLAINED, _CLEARLY = 0.7, 0.3  # share of the squared turns that an offset explains, and more than any other one
_LIKELIER = 20.0  # log likelihood ratio of an offset against none

MIRRORED = (
    "scans turn the other way round from odometry: are the ranges from right to left, or is the laser upside down? "
    "Then set `laser.mirrored`"
)

Ranges = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Turns:
    """Turns of the robot between pairs of scans."""

    stamps_s: Array
    """(P, 2) seconds since the first scan"""
    turns: Array
    """(P,) rad"""


def clock_offset_s(scans: Sequence[tuple[int, Scan]], odometry_ns: NDArray[np.int64], headings: Array) -> float | None:
    """Seconds by which the stamps of scans lead those of odometry; 0 below `least_s`, None where it is not sure.

    `scans` have stamps, ns, of their first beams; `odometry_ns` (N,) ascends, `headings` (N,) rad. An offset is sure if
    it explains most of what the scans say of turns, clearly more than any other offset.
    """
    both = _both(scans, odometry_ns, headings)
    if both is None:
        return None
    found, first_s, heading = both

    def left(offsets_s: Array) -> Array:
        """Share of the squared turns that each offset does not explain."""
        return np.array([_unexplained(found, first_s, heading, offset) for offset in offsets_s])

    coarse = np.arange(-MOST_S, MOST_S + _STEP_S, _STEP_S)
    errors = left(coarse)
    best = int(np.argmin(errors))
    others = errors[np.abs(coarse - coarse[best]) > _NEAR_S]
    if errors[best] > 1.0 - _EXPLAINED or others.min() - errors[best] < _CLEARLY:
        return None
    fine = coarse[best] + np.arange(-2.0 * _STEP_S, 2.5 * _STEP_S, _FINE_S)
    errors = left(fine)
    offset_s = float(fine[np.argmin(errors)])
    without, within = float(left(np.zeros(1))[0]), max(float(errors.min()), 1e-9)
    is_likelier = 0.5 * len(found.turns) * np.log(without / within) > _LIKELIER
    return offset_s if abs(offset_s) >= least_s(odometry_ns) and is_likelier else 0.0


def least_s(odometry_ns: NDArray[np.int64]) -> float:
    """The smallest offset that is set right: between two records of odometry nothing says when the robot turned."""
    return max(LEAST_S, 1e-9 * float(np.median(np.diff(odometry_ns))))


def are_mirrored(scans: Sequence[tuple[int, Scan]], odometry_ns: NDArray[np.int64], headings: Array) -> bool:
    """Whether scans turn the other way round from odometry of the same clock: from right to left, or upside down."""
    both = _both(scans, odometry_ns, -headings)
    return both is not None and _unexplained(*both, 0.0) < 1.0 - _EXPLAINED


def _both(
    scans: Sequence[tuple[int, Scan]], odometry_ns: NDArray[np.int64], headings: Array
) -> tuple[Turns, float, Array] | None:
    """Turns by scans, and headings (G,) by odometry, every `_GRID_S` from a time on, seconds since the first scan.

    None where the robot hardly turns.
    """
    if len(scans) < 2 or len(odometry_ns) < 2:
        return None
    found = scan_turns(scans)
    known_s = 1e-9 * (odometry_ns - int(scans[0][0])).astype(np.float64)
    is_long = known_s[-1] - known_s[0] > _LONGEST_LOG_S
    if is_long or np.count_nonzero(np.abs(found.turns) > _TURN_RAD) < _FEWEST_TURNS:
        return None
    grid_s = np.arange(known_s[0], known_s[-1] + _GRID_S, _GRID_S)
    return found, float(known_s[0]), np.interp(grid_s, known_s, np.unwrap(headings))


def scan_turns(scans: Sequence[tuple[int, Scan]]) -> Turns:
    """What pairs of scans, at the middle of their sweeps, say of the robot's turn between the two."""
    origin_ns = scans[0][0]
    middles_s = np.array(
        [1e-9 * (own - origin_ns - 0.5 * sweep_ns(len(scan.ranges), scan.time_increment)) for own, scan in scans]
    )
    seconds = np.searchsorted(middles_s, middles_s + _APART_S - 1e-6)
    firsts = np.flatnonzero(seconds < len(scans))
    apart = middles_s[seconds[firsts]] - middles_s[firsts]
    firsts = firsts[(apart > 0.0) & (apart < _LONGEST_S)]
    firsts = firsts[np.unique(np.linspace(0, len(firsts) - 1, min(_PAIRS, len(firsts))).astype(int))]
    seconds = seconds[firsts]
    views = {k: view(scans[k][1]) for k in np.unique([firsts, seconds]).tolist()}
    shape = (-1, _BINS)
    before = np.array([views[k] for k in firsts.tolist()], dtype=np.float32).reshape(shape)
    after = np.array([views[k] for k in seconds.tolist()], dtype=np.float32).reshape(shape)
    turns, is_seen = shifts(before, after)
    stamps = np.stack([middles_s[firsts], middles_s[seconds]], axis=1)
    return Turns(stamps[is_seen], turns[is_seen])


def view(scan: Scan) -> Ranges:
    """(_BINS,) range by bearing around the robot's axis, m; NaN where nothing is seen nearby."""
    out = np.full(_BINS, np.nan, dtype=np.float32)
    seen = (scan.ranges > 0.0) & (scan.ranges < min(_FAR_M, scan.max_range))
    bins = np.floor(scan.bearings[seen] * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS
    out[bins] = scan.ranges[seen]
    return out


def shifts(before: Ranges, after: Ranges) -> tuple[Array, NDArray[np.bool_]]:
    """(P,) turns, rad, that lay the views (P, _BINS) before on those after best, and whether they are seen."""
    shifts = np.arange(-_SHIFTS, _SHIFTS + 1)
    errors = np.full((len(shifts), len(before)), np.inf, dtype=np.float32)
    for row, shift in enumerate(shifts.tolist()):
        off = np.minimum(np.abs(np.roll(before, -shift, axis=1) - after), _MOST_M)
        both = np.isfinite(off)
        count = both.sum(axis=1)
        total = np.where(both, off, 0.0).sum(axis=1)
        errors[row] = np.where(count >= _FEWEST_BINS, total / np.maximum(count, 1), np.inf)
    best = np.argmin(errors, axis=0)
    pairs = np.arange(len(before))
    inner = np.clip(best, 1, len(shifts) - 2)
    low, here, high = (errors[inner + side, pairs].astype(np.float64) for side in (-1, 0, 1))
    is_seen = np.isfinite(low) & np.isfinite(here) & np.isfinite(high) & (best == inner)
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = low - 2.0 * here + high
        part = np.where(bend > 1e-9, 0.5 * (low - high) / bend, 0.0)
    return (shifts[best] + np.nan_to_num(part)) * (2.0 * np.pi / _BINS), is_seen


def _unexplained(found: Turns, first_s: float, heading: Array, offset_s: float) -> float:
    """Share of the squared turns, capped, that odometry with this offset does not explain; 1 where it knows of few.

    `heading` (G,) rad begins at `first_s`, and has a value every `_GRID_S`.
    """
    rows = np.rint((found.stamps_s - (offset_s + first_s)) / _GRID_S).astype(np.int64)
    inside = (rows[:, 0] >= 0) & (rows[:, 1] < len(heading))
    squares = np.minimum(np.abs(found.turns), _CAP_RAD) ** 2
    known = float(squares[inside].sum())
    if known <= _KNOWN * squares.sum():
        return 1.0
    at = heading[rows[inside]]
    off = np.abs(wrap_angle(found.turns[inside] - (at[:, 1] - at[:, 0])))
    return float(np.sum(np.minimum(off, _CAP_RAD) ** 2)) / known
