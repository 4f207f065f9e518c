"""Verification of a place: pairs of scans are aligned at it, see each other's surfaces, and agree about the pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.evidence import PlacedScans
from sixthsense.slam.scans.graph import AGREEMENT
from sixthsense.slam.scans.links import WIDE_GATE_M, Alignments, align_pairs
from sixthsense.slam.scans.place_search import Hypothesis, of_last_metres
from sixthsense.slam.scans.tracking import NEAREST
from sixthsense.slam.scans.votes import NEAR, Vote

_LEAST_GOOD, _GOOD_SHARE = 3, 0.4  # pairs that align, and their share of those that tell about the place


class Verified(NamedTuple):
    """A place that pairs of scans agree about."""

    pose: Array
    """(3,) of the newest scan"""
    links: list[tuple[Alignments, int]]
    """the alignments and their good rows"""


def verified(scans: PlacedScans, key: int, recent: NDArray[np.int64], found: Hypothesis) -> Verified | None:
    """Align the scans `recent`, moved with `key` to the hypothesis, with what is known around it.

    None if too few pairs align, or if they do not agree.
    """
    moved = compose(found.pose, between(scans.poses[key], scans.poses[recent]))
    targets, sources, starts = _pairs(scans, found, recent, moved)
    poses = scans.poses
    aligned = align_pairs(scans.store.returns, targets, sources, starts, WIDE_GATE_M)
    # A robot that comes the other way sees little of what an old scan saw: pairs are judged by that alone.
    tell = aligned.tell()
    good = aligned.agree(AGREEMENT, scans.usual_agreement, least_seen=0.0) & tell
    least = max(_LEAST_GOOD, _GOOD_SHARE * np.count_nonzero(tell))
    if np.count_nonzero(good) < least:
        return None
    said = compose(compose(poses[targets], aligned.poses), between(poses[sources], poses[key]))
    said[:, 2] = found.pose[2] + wrap_angle(said[:, 2] - found.pose[2])  # headings on both sides of half a turn
    middle = np.median(said[good], axis=0)
    good &= NEAR.same(said - middle)
    rows = np.flatnonzero(good)
    if len(rows) < least or len(set(sources[rows].tolist())) < 2:
        return None
    return Verified(middle, [(aligned, int(k)) for k in rows])


def vote_for(scans: PlacedScans, key: int, travelled_m: Array, found: Hypothesis) -> Vote | None:
    """A vote for a place of scan `key`, if those of the last metres agree about it; `travelled_m` (K,) is at each."""
    good = verified(scans, key, of_last_metres(travelled_m, key), found)
    return None if good is None else Vote(key, good.pose, float(travelled_m[key]), good.links)


def _pairs(
    scans: PlacedScans, found: Hypothesis, recent: NDArray[np.int64], moved: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Targets, sources and relative poses (m, 3) of pairs whose views overlap; every other recent scan is used."""
    pairs = [
        (target, int(recent[k]), k)
        for k in range(len(recent) - 1, -1, -2)
        for target in found.known.partners(int(recent[k]), moved[k], NEAREST).tolist()
    ]
    targets, sources, rows = np.array(pairs, dtype=np.int64).reshape(-1, 3).T
    old = ~np.isin(targets, recent)
    return targets[old], sources[old], between(scans.poses[targets[old]], moved[rows[old]])
