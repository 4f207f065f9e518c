"""What scans that are some metres apart say of a place: how much of what both could see they explain.

The scans are followed back from the newest one, each aligned with old keyframes from where the one before it was. What
the old scans could not have seen is no evidence, and what they saw through is evidence against the place: in the score
of a submap both look alike. Two places are compared on the scans that tell about both, since a scan of which little is
explained at one place has little explained at all places that look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose, inverse
from sixthsense.slam.scans.alignment import HITS
from sixthsense.slam.scans.graph import REACH_M, ScanGraph
from sixthsense.slam.scans.links import LEAST_HITS, SEEN_SHARE, WIDE_GATE_M, align_pairs
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.visibility import explained

_PARTNERS = 2  # known scans that each is compared with
BACK_M, _EVERY_M = 12.0, 1.0  # travel over which scans are followed back, and between two of them
_SHIFT_M, _SHIFT_M_PER_M = 0.05, 0.08  # an alignment may shift a scan beyond the one before
_SHIFT_RAD = 0.1
_LEAST_SCANS = 3  # that tell about two places which are compared, where there are as many
_CLEARLY = 0.32  # scans' worth of points that a place must explain beyond another one
_SCANS_BEYOND = 6  # or this many scans more that tell about it


class PlacedScans(Protocol):
    """Scans with their poses."""

    @property
    def store(self) -> ScanStore:
        """The scans, a row each."""

    @property
    def poses(self) -> Array:
        """(K, 3) of their lasers."""

    @property
    def usual_agreement(self) -> float:
        """Share of the returns, of those that are judged, that scans of one place usually agree in."""


class Surroundings(Protocol):
    """What is known of a place."""

    def partners(self, key: int, at: Array, most: int) -> NDArray[np.int64]:
        """Rows of up to `most` scans whose views overlap that of scan `key` if its laser is at `at` (3,)."""


class OldPass(NamedTuple):
    """Old keyframes of one pass."""

    graph: ScanGraph
    keys: NDArray[np.int64]

    def partners(self, key: int, at: Array, most: int) -> NDArray[np.int64]:
        """Those whose views overlap most."""
        return self.keys[self.graph.overlapping(key, at, self.keys, REACH_M)[:most]]


class Evidence(NamedTuple):
    """What scans say of a place."""

    pose: Array
    """(3,) of the newest scan, aligned"""
    shares: Array
    """(n,) of what a scan and the old ones could both see: the part that is explained; NaN where that is too little"""

    @property
    def weight(self) -> float:
        """Scans that the place explains, beyond a half each."""
        return float(np.nansum(self.shares - 0.5))

    def is_clearly_better(self, other: Evidence) -> bool:
        """Whether this place explains clearly more than another one, on the same scans."""
        off = self.shares - other.shares
        both, least = np.isfinite(off), min(_LEAST_SCANS, len(off))
        if both.sum() >= least:
            return float(off[both].sum()) >= _CLEARLY * least / _LEAST_SCANS
        return int(np.isfinite(self.shares).sum()) - int(np.isfinite(other.shares).sum()) >= _SCANS_BEYOND


def followed_back(travelled_m: Array, key: int) -> NDArray[np.int64]:
    """Keyframes that are followed back from `key`, the newest first; `travelled_m` (K,) is at each keyframe."""
    keys = np.flatnonzero(travelled_m[: key + 1] >= travelled_m[key] - BACK_M - _EVERY_M)
    steps = np.floor((travelled_m[key] - travelled_m[keys]) / _EVERY_M)
    back = keys[(np.diff(steps, append=-1.0) < 0.0) & (steps <= BACK_M / _EVERY_M)][::-1]
    return np.asarray(back, dtype=np.int64)


def evidence_of(
    scans: PlacedScans, keys: NDArray[np.int64], places: Array, known: Sequence[Surroundings]
) -> list[Evidence]:
    """What the scans `keys` say of each of the places (m, 3), poses of the first one in the frame of what is `known`.

    A place that explains clearly less than another one is not followed further back.
    """
    poses, at, before = scans.poses, np.array(places, dtype=np.float64), int(keys[0])
    shares, newest = np.full((len(at), len(keys)), np.nan), at.copy()
    open_places = np.arange(len(at))
    for n, key in enumerate(keys.tolist()):
        moved = between(poses[before], poses[key])
        most_m = WIDE_GATE_M if n == 0 else _SHIFT_M + _SHIFT_M_PER_M * float(np.hypot(moved[0], moved[1]))
        for k in open_places.tolist():
            shares[k, n], at[k] = _compared(scans, key, compose(at[k], moved), known[k], most_m)
        if n == 0:
            newest = at.copy()
        best = shares[open_places[np.argmax(np.nansum(shares[open_places] - 0.5, axis=1))]]
        off = best - shares[open_places]
        tells = np.isfinite(off).sum(axis=1) >= _LEAST_SCANS
        open_places = open_places[~(tells & (np.nansum(off, axis=1) >= _CLEARLY))]
        before = key
    return [Evidence(pose, row) for pose, row in zip(newest, shares, strict=True)]


def _compared(scans: PlacedScans, key: int, at: Array, known: Surroundings, most_m: float) -> tuple[float, Array]:
    """The share that a scan at a pose and those around it explain, and its pose as aligned with them."""
    targets = known.partners(key, at, _PARTNERS)
    if not len(targets):
        return np.nan, at
    poses, returns = scans.poses, scans.store.returns
    off = between(poses[targets], at)
    aligned = align_pairs(returns, targets, np.full(len(targets), key), off, WIDE_GATE_M)
    shift = between(off, aligned.poses)
    is_near = (np.hypot(shift[:, 0], shift[:, 1]) <= most_m) & (np.abs(shift[:, 2]) <= _SHIFT_RAD)
    is_near &= aligned.sums[:, HITS] >= LEAST_HITS
    total, best, there = np.zeros(3), 0.0, at
    for k, target in enumerate(targets.tolist()):
        pair = aligned.poses[k] if is_near[k] else off[k]
        found = explained(returns, target, key, pair) + explained(returns, key, target, inverse(pair))
        total += found
        if is_near[k] and found[0] > best:
            best, there = found[0], compose(poses[target], pair)
    share = float(total[0] / total[1]) if total[1] >= max(SEEN_SHARE * total[2], 1.0) else np.nan
    return share, there
