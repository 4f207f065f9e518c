"""Search of a scan's place among known scans: of earlier passes, or of an earlier run.

Places are proposed by what they look like, and by how likely the robot is near them; what was seen on the last metres
is searched for there by branch and bound. The scans of the last metres are the evidence: how much of what they and the
known scans could both see lies on the same lines. They are followed back from the newest one, each aligned with known
ones from where the one before it was. What the known scans could not have seen is no evidence, and what they saw
through is evidence against the place: in the score of a submap both look alike. Two places are compared on the scans
that are evidence about both, since a scan of which little is explained at one place has little explained at all places
that look alike. Votes some metres apart must agree before a place is believed. The pairs of scans that aligned at it
are its links.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.parts import PLACE_SEARCHES
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose, inverse, triple
from sixthsense.slam.scans.agreement import LEAST_RETURNS, agreement
from sixthsense.slam.scans.alignment import SURFACE_M
from sixthsense.slam.scans.graph import REACH_M, PlacedScans, overlapping
from sixthsense.slam.scans.known_places import (
    BACK_M,
    HALF_M,
    LEAST_POINTS,
    KnownPlaces,
    of_last_metres,
    surfaces_around,
)
from sixthsense.slam.scans.links import SEEN_SHARE, WIDE_GATE_M, Alignments, align_pairs
from sixthsense.slam.scans.places import MOST_POINTS, MOST_TRIED, PLACE, Apart, Pyramid, Window, appearance, peaks
from sixthsense.slam.scans.tracking import FREEDOM

SIGMAS = 2.0
"""of a pose, within which a place is expected"""
_MARGIN_M, _MARGIN_RAD = 1.5, 0.12  # beyond these it is searched for, too
_AS_GOOD = 0.7  # a place with at least this part of the best score is compared with it
_MOST_COMPARED = 16  # with more places, all are taken to be alike

_PARTNERS = 2  # known scans that each is compared with
_EVERY_M = 1.0  # travel between two scans that are followed back
LEAST_SCANS = 3
"""that are evidence about two places which are compared, and links of a vote, where there are as many"""
_CLEARLY = 0.32  # scans' worth of points that a place must explain beyond another one

NEW_M = 1.5
"""travel that shows something new: between two votes that count both, and two searches of alike places"""
NEAR = Apart(0.35, 0.06)
"""poses that agree about a place"""


class ExpectedPoses(NamedTuple):
    """Where the newest scan is expected, without the scans."""

    poses: Array
    """(n, 3) of its laser, in the frame of each anchor"""
    sigma_m: Array
    """(n,) of the position; infinite if nothing is known"""
    sigma_rad: Array
    """(n,) of the heading"""

    @classmethod
    def anywhere(cls, count: int) -> ExpectedPoses:
        """At any of so many places, with any heading."""
        return cls(np.zeros((count, 3)), np.full(count, np.inf), np.full(count, np.inf))

    def window(self, place: int) -> Window | None:
        """Where around an anchor the scan may be; None if it is nowhere there."""
        x, y, theta = self.poses[place]
        half_m = SIGMAS * self.sigma_m[place] + _MARGIN_M
        low, high = np.maximum((x - half_m, y - half_m), -HALF_M), np.minimum((x + half_m, y + half_m), HALF_M)
        if (low > high).any():
            return None
        half_rad = min(SIGMAS * float(self.sigma_rad[place]) + _MARGIN_RAD, math.pi)
        return Window(np.array([*(0.5 * (low + high)), theta]), 0.5 * float((high - low).max()), half_rad)


class Candidate(NamedTuple):
    """A place where the last metres may have been seen."""

    pose: Array
    """(3,) of the newest scan's laser"""
    score: float
    """share of the points that are explained"""
    known: NDArray[np.int64]
    """rows of the known scans around it"""


class PlaceQuery(NamedTuple):
    """What is asked: where scan `key` may be among known places."""

    scans: PlacedScans
    key: int
    """row of the newest scan"""
    places: KnownPlaces
    expected: ExpectedPoses
    """where the scan is by the track, in the frame of each place"""
    min_score: float
    """least share of the points, of those in which scans usually agree, that a place must explain"""
    last: int
    """scans, the newest ones, that are searched for and judged alone; 0: those of the last metres"""

    @property
    def searched(self) -> NDArray[np.int64]:
        """Rows of the scans that are searched for."""
        rows = of_last_metres(self.scans.travelled_m, self.key)
        return rows[-self.last :] if self.last else rows


class PlaceSearch(Protocol):
    """Proposes where the newest scan may be among what is known: among earlier passes, and where a robot is lost.

    It is made with an object of its `Options`, if it has any, and without arguments otherwise. What it proposes is no
    evidence: the scans of the last metres judge it, and two votes that are metres apart must agree. Where a log ends
    the query's `last` scans alone are searched for and judge.

    1. A candidate's `pose` (3,) is that of the scan's laser, m and rad, in the frame of `places.anchors`; `score` is
       between 0 and 1; `known` is `places.surroundings` of a place around it.
    2. Candidates are of different places, the best score first.
    3. Where no place is good enough there is none; that is no error.
    4. The same query gives the same bits, and scans and places stay as they are.
    """

    def propose(self, query: PlaceQuery) -> Sequence[Candidate]:
        """Propose places of the newest scan."""


class BranchAndBound:
    """What was seen on the last metres, searched for in the likeliest submaps."""

    def propose(self, query: PlaceQuery, least_points: int = LEAST_POINTS) -> Sequence[Candidate]:
        """Propose places that explain enough of what was seen, of at least so many points."""
        scans, key, places, expected, min_score, _ = query
        keys = query.searched
        near, range_m = surfaces_around(scans, keys, between(scans.poses[key], scans.poses[keys]))
        if len(near) < least_points:
            return []
        rows = np.linspace(0, len(near) - 1, min(len(near), MOST_POINTS)).astype(np.int64)
        points, looks = np.ascontiguousarray(near[rows, :2]), list[tuple[int, Pyramid, Window]]()
        for place in likeliest(places, expected, appearance(near)):
            window = expected.window(place)
            if window is not None:
                looks.append((place, places.submap(place, range_m), window))
        top = least = min_score * scans.usual_agreement
        for _, submap, window in looks:
            best = peaks(submap, points, window, top, PLACE, most=1)
            top = float(best[0, 0]) if len(best) else top
        # What is worth a comparison is known only now, and most searches stop at this test.
        if top <= least:
            return []
        found: list[Candidate] = []
        for place, submap, window in looks:
            best = peaks(submap, points, window, _AS_GOOD * top, PLACE, _MOST_COMPARED + 1)
            known = places.surroundings(place)
            placed = compose(places.anchors[place], best[:, 1:]).reshape(-1, 3)
            found += [Candidate(pose, score, known) for pose, score in zip(placed, best[:, 0].tolist(), strict=True)]
        return distinct(found)


def place_search_of(config: Config) -> PlaceSearch:
    """The configured place search."""
    found: PlaceSearch = part_of(config, PLACE_SEARCHES).make()
    return found


def likeliest(places: KnownPlaces, expected: ExpectedPoses, look: Array) -> list[int]:
    """Places that look most like `look` (BINS,) does, and that the scan is likely near; some metres apart."""
    anchors = places.anchors
    if not len(anchors):
        return []
    alike = places.looks @ look
    square = (expected.poses[:, :2] ** 2).sum(axis=1) / (expected.sigma_m**2 + REACH_M**2)
    score = (alike - alike.mean()) / (float(alike.std()) or 1.0)
    score -= 0.5 * (FREEDOM + 2.0) * np.log1p(square / FREEDOM)
    chosen: list[int] = []
    for place in np.argsort(-score, kind="stable").tolist():
        gap = anchors[chosen, :2] - anchors[place, :2]
        if (np.hypot(gap[:, 0], gap[:, 1]) > REACH_M).all():
            chosen.append(place)
            if len(chosen) == MOST_TRIED:
                break
    return chosen


def distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates of different places, the best score first; one more than are compared, at most."""
    chosen: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.score):
        if len(chosen) > _MOST_COMPARED:
            break
        if not any(is_same_place(candidate.pose, known.pose) for known in chosen):
            chosen.append(candidate)
    return chosen


def is_same_place(one: Array, other: Array) -> bool:
    """Whether two poses (3,) are nearer than places can be told apart."""
    return bool(PLACE.same(between(one, other)))


class Evidence(NamedTuple):
    """How well scans fit a place."""

    pose: Array
    """(3,) of the newest scan, aligned"""
    shares: Array
    """(n,) of what a scan and the known ones could both see: the part on the same lines; NaN where too little is"""
    links: tuple[Alignments, ...]
    """the pairs of scans that aligned"""

    @property
    def weight(self) -> float:
        """Scans that the place explains, beyond a half each."""
        return float(np.nansum(self.shares - 0.5))

    def is_clearly_better(self, other: Evidence) -> bool:
        """Whether this place explains clearly more than another one, on the same scans."""
        off = self.shares - other.shares
        both, least = np.isfinite(off), min(LEAST_SCANS, len(off))
        return bool(both.sum() >= least and off[both].sum() >= _CLEARLY * least / LEAST_SCANS)


class Hypothesis(NamedTuple):
    """The best place of the newest scan."""

    evidence: Evidence
    is_ambiguous: bool
    """whether another place is nearly as good"""


def best_place(query: PlaceQuery, search: PlaceSearch) -> Hypothesis | None:
    """The best pose of the newest scan by all that `search` proposes; None if nothing is good enough."""
    candidates = search.propose(query)
    if not type(search).__module__.startswith("sixthsense."):
        for one in candidates:
            check_returned("place_search", "propose", one, Candidate, pose=(3,))
    if not candidates:
        return None
    keys = query.searched[::-1] if query.last else followed_back(query.scans.travelled_m, query.key)
    return judged(query.scans, keys, candidates)


def judged(scans: PlacedScans, keys: NDArray[np.int64], candidates: Sequence[Candidate]) -> Hypothesis:
    """The candidate, of at least one, that explains the scans `keys` best; whether another one is nearly as good."""
    if len(candidates) > _MOST_COMPARED:
        return Hypothesis(evidence_of(scans, keys[:1], candidates[:1])[0], True)
    found = evidence_of(scans, keys, candidates)
    best = max(found, key=lambda each: each.weight)
    others = [each for each in found if not is_same_place(best.pose, each.pose)]
    return Hypothesis(best, not all(best.is_clearly_better(other) for other in others))


def followed_back(travelled_m: Array, key: int) -> NDArray[np.int64]:
    """Keyframes that are followed back from `key`, the newest first; `travelled_m` (K,) is at each keyframe."""
    keys = np.flatnonzero(travelled_m[: key + 1] >= travelled_m[key] - BACK_M - _EVERY_M)
    steps = np.floor((travelled_m[key] - travelled_m[keys]) / _EVERY_M)
    back = keys[(np.diff(steps, append=-1.0) < 0.0) & (steps <= BACK_M / _EVERY_M)][::-1]
    return np.asarray(back, dtype=np.int64)


def evidence_of(scans: PlacedScans, keys: NDArray[np.int64], candidates: Sequence[Candidate]) -> list[Evidence]:
    """How well the scans `keys`, the newest first, fit each of the candidates.

    They are compared with scans from before all of them. A place that explains clearly less than another one is not
    followed further back.
    """
    poses, before = scans.poses, int(keys[0])
    at = np.array([candidate.pose for candidate in candidates], dtype=np.float64)
    shares, newest, links = np.full((len(at), len(keys)), np.nan), at.copy(), [list[Alignments]() for _ in at]
    open_places, known = np.arange(len(at)), [each.known[each.known < keys[-1]] for each in candidates]
    for n, key in enumerate(keys.tolist()):
        moved = between(poses[before], poses[key])
        # The candidate's pose is coarse. From the second scan on it is aligned, and the motion between them is tracked.
        most_m = WIDE_GATE_M if n == 0 else SURFACE_M
        for k in open_places.tolist():
            placed = compose(at[k], moved)
            shares[k, n], at[k], found = _compared(scans, key, placed, known[k], most_m)
            links[k].append(found)
        if n == 0:
            newest = at.copy()
        best = shares[open_places[np.argmax(np.nansum(shares[open_places] - 0.5, axis=1))]]
        off = best - shares[open_places]
        is_told = np.isfinite(off).sum(axis=1) >= LEAST_SCANS
        open_places = open_places[~(is_told & (np.nansum(off, axis=1) >= _CLEARLY))]
        before = key
    return [Evidence(*each) for each in zip(newest, shares, map(tuple, links), strict=True)]


def _compared(
    scans: PlacedScans, key: int, at: Array, known: NDArray[np.int64], most_m: float
) -> tuple[float, Array, Alignments]:
    """The share that a scan at a pose and those around it explain, its pose as aligned with them, and its links."""
    poses, returns = scans.poses, scans.store.returns
    targets = overlapping(scans, key, at, known)[:_PARTNERS]
    off = between(poses[targets], at).reshape(-1, 3)
    found = align_pairs(returns, targets, np.full(len(targets), key), off, WIDE_GATE_M)
    shift = between(off, found.poses).reshape(-1, 3)
    is_near = (np.hypot(shift[:, 0], shift[:, 1]) <= most_m) & (found.partners >= LEAST_RETURNS)
    seen = found.seen.sum(axis=1)
    for k in np.flatnonzero(~is_near).tolist():
        pair, target = triple(off[k]), int(targets[k])
        both = [agreement(returns, target, key, pair), agreement(returns, key, target, inverse(pair))]
        seen[k] = np.array(both).sum(axis=0)
    lines, hits, through, count = seen.sum(axis=0).tolist()
    share = lines / (hits + through) if hits + through >= max(SEEN_SHARE * count, 1.0) else np.nan
    if is_near.any():
        best = int(np.argmax(np.where(is_near, seen[:, 0], -1.0)))
        at = compose(poses[targets[best]], found.poses[best])
    return share, at, found.rows(is_near & found.agree(scans.usual_agreement, least_seen=0.0))


class Vote(NamedTuple):
    """A place that was found."""

    key: int
    pose: Array
    """(3,) of that scan, in the frame of what is known"""
    travelled_m: float
    links: Alignments
    """pairs of scans that aligned there"""


class Votes:
    """The votes of the last metres."""

    def __init__(self, scans: PlacedScans) -> None:
        self._scans = scans
        self._votes: list[Vote] = []

    def agreeing(self, key: int, found: Evidence) -> list[Vote]:
        """Count a place of scan `key` as a vote; the votes that agree about it, if it is to be believed.

        They must be far enough apart, and more than half of those of the last metres.
        """
        links = Alignments.joined(found.links)
        compared = len(found.shares)  # after the start there are few scans to follow back
        if len(links.targets) < min(LEAST_SCANS, compared) or len(np.unique(links.sources)) < min(2, compared):
            return []
        vote = Vote(key, found.pose, float(self._scans.travelled_m[key]), links)
        self._votes = [*(each for each in self._votes if vote.travelled_m - each.travelled_m < BACK_M), vote]
        agreeing = [each for each in self._votes if self._agree(each, vote)]
        span = vote.travelled_m - agreeing[0].travelled_m
        if span < NEW_M or 2 * len(agreeing) <= len(self._votes):
            return []
        self._votes = []
        return agreeing

    def _agree(self, one: Vote, newest: Vote) -> bool:
        """Whether two votes agree about the newest scan's pose."""
        poses = self._scans.poses
        moved = compose(one.pose, between(poses[one.key], poses[newest.key]))
        return bool(NEAR.same(between(moved, newest.pose)))
