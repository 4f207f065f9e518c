"""What speaks against a map, by keyframe and as a whole."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds
from sixthsense.logs.diagnose import Mount
from sixthsense.slam.front_end import LoopClosureCounts
from sixthsense.verdict import disagreement as by_wheels
from sixthsense.verdict import views as by_scans
from sixthsense.verdict.disagreement import Disagreement, Lag, Mirror, Turns
from sixthsense.verdict.views import ALL, FEWEST, NEXT, SURFACE, THROUGH
from sixthsense.verdict.witnesses import Witnesses

_SIDE = NEXT + 2  # keyframes on each side of a cut that tell what scans contradict there anyway
WINDOW_M = 10.0
"""of travel, over which a keyframe's pose is judged"""


class Evidence(NamedTuple):
    """Evidence of K keyframes; NaN where nothing is known."""

    stamps_s: Array
    """(K,) since the first scan"""
    travel: Array
    """(K,) m since the first keyframe, a turn of a radian counting as half a metre"""
    returns: Array
    """(K,) returns of the scan"""
    recent: Array
    """(K, 3) returns compared with scans of the last 10 m: confirmed, seen through, and all, also those not judged"""
    cut: Array
    """(K,) least share contradicted between scans right before a keyframe and from it on, less what is usual there"""
    overlap: Array
    """(K,) largest share of returns confirmed of a scan before each and one from it on, not far apart"""
    old: Array
    """(K, 3) the same of scans of other passes"""
    bends: float
    """share of what is judged that scans some 2 m of travel and more apart contradict, less that of successive ones"""
    wheels: Disagreement
    links: Array
    """(K,) links that hold the keyframe and those after it to those before; matched landmarks where these are used"""
    mirror: Mirror | None
    mount: Mount | None
    turns: Turns | None
    lag: Lag | None
    closures: LoopClosureCounts | None
    old_pairs: NDArray[np.int64]
    """(m, 2) keyframes of two passes that were compared"""
    old_found: NDArray[np.int64]
    """(m, 3) what of their returns was judged"""


def evidence_of(found: Witnesses) -> Evidence:
    """The evidence in what a run has left behind."""
    count = len(found.trajectory)
    travel, rows = by_scans.travelled(found.trajectory), np.maximum(found.keys, 0)
    stamps_s = seconds((found.stamps_ns - found.stamps_ns[:1]).astype(np.float64))
    wheels = None if found.wheels is None or not len(rows) else found.wheels[rows]
    measured = found.is_measured & (found.keys >= 0)
    off = by_wheels.disagreement(wheels, found.trajectory, measured)
    recent, old = (np.full((count, 3), np.nan) for _ in range(2))
    cut, overlap = (np.full(count, np.nan) for _ in range(2))
    returns, seen, far, near = np.full(count, np.nan), None, 0.0, 0.0
    pairs, by_pair = np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    if found.scans:
        views = by_scans.views_of(found.scans)
        returns = views.returns.astype(np.float64)
        before, pairs = by_scans.recent_pairs(travel), by_scans.old_pairs(found.trajectory, travel)
        judged, by_pair = (by_scans.compared(views, found.trajectory, each) for each in (before, pairs))
        recent, old = _by_keyframe(before[:, 1:], judged, count), _by_keyframe(pairs, by_pair, count)
        cut, overlap = _cuts(before, judged, count), _overlaps(before, judged, count)
        are_far = np.diff(travel[before])[:, 0] > 0.9 * by_scans.BACK_M[0]
        far, near = (share(judged[own].sum(axis=0)[None])[0] for own in (are_far, np.diff(before)[:, 0] == 1))
        seen = by_wheels.mirror(views, off) if wheels is not None else None
    at = stamps_s[rows] if len(stamps_s) else np.zeros(count)
    late = None
    if found.wheels is not None and found.matched is None and measured.all():
        late = by_wheels.lag(stamps_s, found.wheels, found.poses)
    return Evidence(
        at, travel, returns, recent, cut, overlap, old, float(np.nan_to_num(far - near)), off, _ties(found, count),
        seen, by_wheels.mount(off), by_wheels.turns(off), late, found.closures, pairs, by_pair,
    )  # fmt: skip


def contradicted_between(found: Witnesses, first: int) -> tuple[float, float]:
    """Share of what is judged that the scans before keyframe `first` and those from it on contradict of each other.

    And the same share of each of both alone. Both are 0 where nothing is judged.
    """
    travel = by_scans.travelled(found.trajectory)
    pairs = np.concatenate([by_scans.recent_pairs(travel), by_scans.old_pairs(found.trajectory, travel)])
    judged = by_scans.compared(by_scans.views_of(found.scans), found.trajectory, pairs)
    joins = (pairs < first).sum(axis=1) == 1
    between, own = (share(judged[which].sum(axis=0)[None].astype(np.float64))[0] for which in (joins, ~joins))
    return float(np.nan_to_num(between)), float(np.nan_to_num(own))


def _cuts(pairs: NDArray[np.int64], found: NDArray[np.int64], count: int) -> Array:
    """(K,) least share contradicted of the pairs of one keyframe before each and one from it on.

    A single scan that fits nothing is no cut if the next ones fit those before, by enough returns.
    """
    steps = pairs[:, 1] - pairs[:, 0]
    is_near = (steps <= NEXT) & (found[:, SURFACE] + found[:, THROUGH] >= FEWEST)
    shares = np.full((count, NEXT + 1), np.nan)  # of each keyframe and the one that is so many before it
    shares[pairs[is_near, 1], steps[is_near]] = share(found[is_near].astype(np.float64))
    across = [(late, step) for late in range(NEXT) for step in range(late + 1, NEXT + 1)]
    within = [(late, step) for late in range(1, _SIDE) for step in range(1, min(late, NEXT) + 1)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # what nothing has judged is not known
        least = np.nanmin(_shifted(shares, across), axis=0)
        after = np.nanmedian(_shifted(shares, within), axis=0)
        before = np.nanmedian(_shifted(shares, [(late - _SIDE, step) for late, step in within]), axis=0)
    return np.asarray(np.maximum(least - np.fmax(np.fmax(before, after), 0.0), 0.0))


def _shifted(shares: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """(m, K) shares, (K, NEXT + 1), of pairs (later keyframe by its distance from each, steps between the two)."""
    own = np.arange(len(shares)) + np.array([late for late, _ in pairs])[:, None]
    steps = np.array([step for _, step in pairs])[:, None]
    is_there = (own >= 0) & (own < len(shares))
    return np.where(is_there, shares[np.where(is_there, own, 0), steps], np.nan)


def _overlaps(pairs: NDArray[np.int64], found: NDArray[np.int64], count: int) -> Array:
    """(K,) the best share of returns confirmed of the pairs of one keyframe before each and one from it on.

    Keyframes without a return cut nothing if the next ones confirm those before. NaN for the first.
    """
    out, shares = np.zeros(count), found[:, SURFACE] / np.maximum(found[:, ALL], 1)
    for k in np.argsort(shares).tolist():  # the best is written last
        out[pairs[k, 0] + 1 : pairs[k, 1] + 1] = shares[k]
    out[:1] = np.nan
    return out


def _by_keyframe(keyframes: NDArray[np.int64], found: NDArray[np.int64], count: int) -> Array:
    """(K, 3) what was found of pairs (m, 3), added up for the keyframes (m, n) that each is of."""
    out = np.zeros((count, 3))
    for column in keyframes.T:
        for part in range(3):
            out[:, part] += np.bincount(column, weights=found[:, part], minlength=count)
    return out


def _ties(found: Witnesses, count: int) -> Array:
    """(K,) what holds each keyframe to those before it."""
    if found.links is not None and len(found.links):
        low, high = found.links.min(axis=1), found.links.max(axis=1)
        change = np.bincount(low + 1, minlength=count + 2) - np.bincount(high + 1, minlength=count + 2)
        return np.asarray(np.cumsum(change)[:count], dtype=np.float64)
    return np.full(count, np.nan) if found.matched is None else found.matched.astype(np.float64)


def share(found: Array) -> Array:
    """(n,) share of what is judged that is contradicted; NaN where nothing is judged.

    A few returns tell little: as many as `FEWEST` that nothing contradicts are known before.
    """
    judged = found[:, SURFACE] + found[:, THROUGH]
    return np.where(judged > 0.0, found[:, THROUGH] / (judged + FEWEST), np.nan)


def over_window(values: Array, travel: Array) -> Array:
    """(K,) largest of the values of the keyframes on the last 10 m before each, and its own; NaN counts as 0."""
    known, first = np.nan_to_num(values), np.searchsorted(travel, travel - WINDOW_M)
    return np.array([known[a : k + 1].max() for k, a in enumerate(first)]) if len(travel) else np.zeros(0)


def sum_over_window(values: Array, travel: Array) -> Array:
    """(K, ...) sum of the values of the keyframes on the last 10 m before each, and its own; NaN counts as 0."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(np.nan_to_num(values), axis=0)])
    first = np.searchsorted(travel, travel - WINDOW_M)
    return np.asarray(total[1:] - total[first])
