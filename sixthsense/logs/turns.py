"""One fit over the turns that scans and odometry both see: the angle between beams, its sign, and the delay of clocks.

The turn between two scans is the shift that lays the one's view, ranges by bearing, on the other's. The earlier scan is
first drawn from where the odometry has the laser later, so that what is left between both views is a turn.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.logs.laser_geometry import with_beams

_PAIRS, _APART_S = 400, 0.3  # pairs of scans, evenly over the log, and the time between the two
_BINS, _SHIFTS, _FEWEST_BINS = 180, 35, 20  # of bearings around a full turn; to either side; that both views have
_FAR_M, _MOST_M, _CAP_RAD = 30.0, 0.5, 0.2  # ranges beyond are not compared; caps of errors
_TURN_RAD, _FEWEST_TURNS, _NOISE_RAD = 0.05, 10, 0.005  # a pair turns by more; fewest of them; and what is seen of it
_GRID_S, _FINE_S = 0.02, 0.6  # of headings, and of the search around other clocks
_MOST_S, _STEP_S, _NEAR_S, _LONGEST_S = 120.0, 0.1, 1.0, 1e5
"""of the search for other clocks; and of a log"""
_EXPLAINED, _CLEARLY, _LIKELIER = 0.7, 0.3, 20.0
"""share of the squared turns that other clocks explain, and more than others do; log likelihood ratio of a fit"""


class Fit(NamedTuple):
    """What the turns say."""

    candidate: int
    """of the lasers that were compared; the one with the likeliest beams"""
    sign: int
    """-1: scans turn the other way round from odometry"""
    scale: float
    """turns of odometry over those of the scans"""
    scale_sigma: float
    lag_s: float
    """by which turns show later in the scans than in the odometry"""
    lag_sigma_s: float
    is_lag: bool
    """whether the delay is likelier than none"""
    is_candidate: bool
    """whether its beams are likelier than those of the others"""
    is_sure: bool
    """whether it explains most of what the scans say of turns"""


class _Turns(NamedTuple):
    """Turns between pairs of scans."""

    times_s: Array
    """(P, 2) of the two, seconds since the first scan"""
    turns: Array
    """(P,) rad"""

    def unexplained(self, headings: _Headings, lags_s: Array) -> Array:
        """(L,) squared errors, capped, of headings that are so much later; of no turn where these are not known."""
        out = []
        for lag in lags_s.tolist():
            off = np.abs(wrap_angle(self.turns - headings.turns(self.times_s - lag)))
            out.append(_capped(np.where(np.isfinite(off), off, self.turns)))
        return np.array(out)


def _capped(turns: Array) -> float:
    """Sum of squares, each capped."""
    return float((np.minimum(np.abs(turns), _CAP_RAD) ** 2).sum())


class _Headings(NamedTuple):
    """Headings of odometry at even times."""

    first_s: float
    values: Array
    """(G,) rad, not wrapped"""

    def turns(self, times_s: Array) -> Array:
        """(P,) turns between two times (P, 2); NaN where they are not known."""
        rows = np.rint((times_s - self.first_s) / _GRID_S).astype(np.int64)
        inside = (rows[:, 0] >= 0) & (rows[:, 1] < len(self.values))
        at = self.values[np.clip(rows, 0, len(self.values) - 1)]
        return np.where(inside, at[:, 1] - at[:, 0], np.nan)


def fit_turns(
    sightings: Sequence[Sighting], odometry: Odometry, lasers: Sequence[tuple[float, float]] = ()
) -> Fit | None:
    """The beams, the sign and the delay with which scans and odometry turn alike; None where the robot hardly turns.

    `lasers` are bearing of the first beam and angle between two that the scans may have, rad; by default their own.
    Clocks may differ by two minutes where the robot turns in a way of its own, and by half a second in any case.
    """
    pairs, times_s = _pairs(sightings)
    known_s = 1e-9 * (odometry.stamps_ns - sightings[0].stamp_ns).astype(np.float64)
    if len(known_s) < 2 or not len(pairs) or not 0.0 < known_s[-1] - known_s[0] < _LONGEST_S:
        return None
    grid_s = np.arange(known_s[0], known_s[-1] + _GRID_S, _GRID_S)
    headings = _Headings(float(known_s[0]), np.interp(grid_s, known_s, np.unwrap(odometry.poses[:, 2])))
    own = [each.scan for each in sightings]
    made = [[with_beams(scan, *laser) for scan in own] for laser in lasers] or [own]
    some = _evenly(len(pairs))
    far_s = _other_clock(_turns(made[0], pairs[some], times_s[some], np.zeros((len(some), 3))), headings)
    lags = far_s + np.arange(-_FINE_S, _FINE_S + 0.5 * _GRID_S, _GRID_S)
    around = np.stack([headings.turns(times_s - lag) for lag in lags[:: max(1, len(lags) // 6)]])
    turning = np.flatnonzero(np.isfinite(around).all(axis=0) & (np.abs(around).max(axis=0) > _TURN_RAD))
    if len(turning) < _FEWEST_TURNS:
        return None
    some = turning[_evenly(len(turning))]
    pairs, times_s = pairs[some], times_s[some]
    moves = _motions(odometry, known_s, times_s - far_s)
    found = []
    for (k, scans), (sign, ahead) in itertools.product(enumerate(made), ((1, 1.0), (-1, 1.0), (1, -1.0))):
        mirrored = [scan.mirrored() for scan in scans] if sign < 0 else scans
        seen = _turns(mirrored, pairs, times_s, moves * (ahead, ahead, 1.0))  # behind: of a laser that looks back
        found.append((k, sign, seen, seen.unexplained(headings, lags)))
    return _judged(found, headings, lags)


def _evenly(count: int) -> NDArray[np.int64]:
    """At most `_PAIRS` rows of so many."""
    return np.unique(np.linspace(0, count - 1, min(_PAIRS, count)).astype(np.int64))


def _judged(found: list[tuple[int, int, _Turns, Array]], headings: _Headings, lags: Array) -> Fit | None:
    """The likeliest of candidates, signs and delays, with what is sure of it."""
    candidate, sign, seen, errors = min(found, key=lambda each: float(each[3].min()))
    best = int(np.clip(np.argmin(errors), 1, len(lags) - 2))
    turns = headings.turns(seen.times_s - lags[best])
    turning = np.abs(turns) > _TURN_RAD
    count = int(np.count_nonzero(turning))
    if count < _FEWEST_TURNS:
        return None
    least = max(float(errors[best]), count * _NOISE_RAD**2)

    def likelier(other: float) -> bool:
        return 0.5 * count * math.log(max(other / least, 1.0)) > _LIKELIER

    none, variance = int(np.argmin(np.abs(lags))), least / count
    wide = max(1, min(best, len(lags) - 1 - best, round(0.1 / _GRID_S)))
    bend = (errors[best - wide] + errors[best + wide] - 2.0 * least) / (wide * _GRID_S) ** 2
    good = turning & (np.abs(wrap_angle(seen.turns - turns)) < _CAP_RAD)
    power = max(float(seen.turns[good] @ seen.turns[good]), 1e-12)
    is_inside = 0 < np.argmin(errors) < len(lags) - 1 and bend > 0.0
    return Fit(
        candidate, sign, float(seen.turns[good] @ turns[good]) / power, math.sqrt(variance / power),
        float(lags[best]), math.sqrt(2.0 * variance / max(bend, 1e-9)),
        is_lag=bool(is_inside and (abs(lags[none]) > _GRID_S or likelier(float(errors[none])))),
        is_candidate=all(likelier(float(each[3].min())) for each in found if each[0] != candidate),
        is_sure=least < (1.0 - _EXPLAINED) * _capped(turns[turning]),
    )  # fmt: skip


def _pairs(sightings: Sequence[Sighting]) -> tuple[NDArray[np.int64], Array]:
    """(P, 2) rows of scans that are compared, and (P, 2) times of the middle of their sweeps, s since the first."""
    times_s = np.array([
        1e-9 * (each.stamp_ns - sightings[0].stamp_ns) + float(each.scan.times_s.min()) / 2.0 for each in sightings
    ])  # fmt: skip
    later = np.searchsorted(times_s, times_s + _APART_S - 1e-6)
    first = np.flatnonzero(later < len(times_s))
    apart = times_s[later[first]] - times_s[first]
    first = first[(apart > 0.0) & (apart < 2.0)]
    pairs = np.stack([first, later[first]], axis=1)
    return pairs, times_s[pairs]


def _motions(odometry: Odometry, known_s: Array, times_s: Array) -> Array:
    """(P, 3) motions between two times (P, 2), s, by odometry; standing still where it is not known."""
    unwrapped = np.column_stack([odometry.poses[:, :2], np.unwrap(odometry.poses[:, 2])])
    first, second = (
        np.stack([np.interp(column, known_s, values) for values in unwrapped.T], axis=1) for column in times_s.T
    )
    moves = between(first, second)
    moves[(times_s[:, 0] < known_s[0]) | (times_s[:, 1] > known_s[-1])] = 0.0
    return moves


def _other_clock(seen: _Turns, headings: _Headings) -> float:
    """Seconds by which clocks differ, as far as turns that no other difference explains say it; else 0."""
    coarse = np.arange(-_MOST_S, _MOST_S + _STEP_S, _STEP_S)
    errors = seen.unexplained(headings, coarse) / max(_capped(seen.turns), 1e-12)
    best = int(np.argmin(errors))
    others = errors[np.abs(coarse - coarse[best]) > _NEAR_S]
    is_sure = errors[best] < 1.0 - _EXPLAINED and others.min() - errors[best] > _CLEARLY
    return float(coarse[best]) if is_sure and abs(coarse[best]) > _FINE_S else 0.0


def _turns(scans: Sequence[Scan], pairs: NDArray[np.int64], times_s: Array, motions: Array) -> _Turns:
    """Turns between pairs of scans, the earlier drawn from where motions (P, 3) of the robot have the laser later."""
    mount = np.broadcast_to(scans[0].T_robot_laser.array(), motions.shape)
    moves = between(mount, compose(motions, mount))  # of the laser, in its frame before; its turn is looked for
    before = np.array(
        [_view(scans[k], x, y) for k, (x, y, _) in zip(pairs[:, 0].tolist(), moves.tolist(), strict=True)]
    )
    after = np.array([_view(scans[k]) for k in pairs[:, 1].tolist()])
    turns, is_seen = _shifts(before, after)
    return _Turns(times_s[is_seen], turns[is_seen])


def _view(scan: Scan, x: float = 0.0, y: float = 0.0) -> NDArray[np.float32]:
    """(_BINS,) range by bearing, m, as seen from a place in the laser's frame; NaN where nothing is seen nearby."""
    out = np.full(_BINS, np.nan, dtype=np.float32)
    seen = (scan.ranges > 0.0) & (scan.ranges < min(_FAR_M, scan.max_range))
    ranges, bearings = scan.ranges[seen].astype(np.float64), scan.bearings[seen]
    if x or y:
        ahead, aside = ranges * np.cos(bearings) - x, ranges * np.sin(bearings) - y
        ranges, bearings = np.hypot(ahead, aside), np.arctan2(aside, ahead)
    order = np.argsort(-ranges)  # the nearest of a bin is written last
    out[np.floor(bearings[order] * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS] = ranges[order]
    return out


def _shifts(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[Array, NDArray[np.bool_]]:
    """(P,) turns, rad, that lay the views (P, _BINS) before on those after best, and whether they are seen."""
    shifts = np.arange(-_SHIFTS, _SHIFTS + 1)
    errors = np.full((len(shifts), len(before)), np.inf, dtype=np.float32)
    for row, shift in enumerate(shifts.tolist()):
        off = np.minimum(np.abs(np.roll(before, -shift, axis=1) - after), _MOST_M)
        count = np.isfinite(off).sum(axis=1)
        errors[row] = np.where(count >= _FEWEST_BINS, np.nansum(off, axis=1) / np.maximum(count, 1), np.inf)
    best = np.argmin(errors, axis=0)
    pairs, inner = np.arange(len(before)), np.clip(best, 1, len(shifts) - 2)
    low, here, high = (errors[inner + side, pairs].astype(np.float64) for side in (-1, 0, 1))
    is_seen = np.isfinite(low) & np.isfinite(here) & np.isfinite(high) & (best == inner)
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = low - 2.0 * here + high
        part = np.where(bend > 1e-9, 0.5 * (low - high) / bend, 0.0)
    return (shifts[best] + np.nan_to_num(part)) * (2.0 * np.pi / _BINS), is_seen
