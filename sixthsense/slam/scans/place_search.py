"""Search of a scan's place in what is known: among earlier passes, or in a map.

Places are proposed by what they look like, and by how likely the robot is near them; what was seen on the last metres
is searched for there by branch and bound. The scans of the last metres judge the places that are found: how much of
what they and the known scans could both see they explain. The scans are followed back from the newest one, each aligned
with known ones from where the one before it was. What the known scans could not have seen is no evidence, and what they
saw through is evidence against the place: in the score of a submap both look alike. Two places are compared on the
scans that tell about both, since a scan of which little is explained at one place has little explained at all places
that look alike. A place is verified by pairs of scans that are aligned at it, see each other's surfaces, and agree
about the pose. Places that are verified some metres apart must agree before one of them is believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.parts import PLACE_SEARCHES
from sixthsense.config.section import shown
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import between, compose, inverse
from sixthsense.slam.scans.alignment import HITS
from sixthsense.slam.scans.graph import AGREEMENT, REACH_M
from sixthsense.slam.scans.links import LEAST_HITS, SEEN_SHARE, WIDE_GATE_M, Alignments, align_pairs
from sixthsense.slam.scans.places import NEAR_M, PLACE, Apart, Pyramid, Window, appearance, peaks, surfaces
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import FREEDOM, NEAREST
from sixthsense.slam.scans.visibility import explained

RECENT_M = 6.0
"""travel of the submap that is searched for"""
_RECENT_VOXEL_M = 0.2  # of these points, and of what places look like; those of old submaps are denser
LEAST_POINTS = 60
"""with fewer points of the last metres what is far away counts, too; with fewer even so there is no search"""
_MOST_POINTS = 200
ANCHORS_APART_M, HALF_M = 3.0, 5.0
"""between the anchors of places, and around each of them to either side"""
_CANDIDATES = 8
SIGMAS = 2.0  # of a pose within a submap
_MARGIN_M, _MARGIN_RAD = 1.5, 0.12  # beyond these
_AS_GOOD = 0.7  # a place with at least this part of the best score is compared with it
_MOST_COMPARED = 16  # with more places, all are taken to be alike

_PARTNERS = 2  # known scans that each is compared with
BACK_M, _EVERY_M = 12.0, 1.0  # travel over which scans are followed back and votes count, and between two scans
_SHIFT_M, _SHIFT_M_PER_M = 0.05, 0.08  # an alignment may shift a scan beyond the one before
_SHIFT_RAD = 0.1
_LEAST_SCANS = 3  # that tell about two places which are compared, where there are as many
_CLEARLY = 0.32  # scans' worth of points that a place must explain beyond another one
_SCANS_BEYOND = 6  # or this many scans more that tell about it

_LEAST_GOOD, _GOOD_SHARE = 3, 0.4  # pairs that align, and their share of those that tell about the place

NEW_M = 1.5  # travel that shows something new: between two votes that count both, and two searches of alike places
NEAR = Apart(0.35, 0.06)  # poses that agree about a place


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


class KnownPlaces(Protocol):
    """What is known, in places around anchors."""

    @property
    def anchors(self) -> Array:
        """(n, 3) poses."""

    @property
    def looks(self) -> Array:
        """(n, BINS) what the places look like."""

    def submap(self, place: int, range_m: float) -> Pyramid:
        """What is seen from a place, in its anchor's frame; `range_m` is how far returns are at most."""

    def surroundings(self, place: int) -> Surroundings:
        """What scans are compared with there."""


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
    known: Surroundings


class Hypothesis(NamedTuple):
    """The best pose of the newest scan."""

    pose: Array
    """(3,) of the laser"""
    known: Surroundings
    """what there is around it"""
    is_ambiguous: bool
    """whether another place is nearly as good"""


class PlaceQuery(NamedTuple):
    """What is asked: where scan `key` may be among known places."""

    scans: PlacedScans
    key: int
    """row of the newest scan"""
    travelled_m: Array
    """(K,) at each scan"""
    places: KnownPlaces
    expected: ExpectedPoses
    """where the scan is by the track, in the frame of each place"""
    min_score: float
    """least share of the points, of those in which scans usually agree, that a place must explain"""


class PlaceSearch(Protocol):
    """Proposes where the newest scan may be among what is known: among earlier passes, and where a robot is lost.

    It is made with an object of its `Options`, if it has any, and without arguments otherwise. What it proposes is no
    evidence: the scans of the last metres judge it, pairs of scans verify it, and two that are metres apart must agree.

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

    def propose(self, query: PlaceQuery) -> Sequence[Candidate]:
        """Propose places that explain enough of what was seen."""
        return proposed(*query)


def place_search_of(config: Config) -> PlaceSearch:
    """The configured place search."""
    found: PlaceSearch = part_of(config, PLACE_SEARCHES).make()
    return found


def candidates_fault(found: object) -> str:
    """What is wrong with the candidates of a place search; "" if nothing."""
    if not isinstance(found, Sequence) or not all(isinstance(one, Candidate) for one in found):
        return f"found {type(found).__name__} {shown(found)}, allowed: a list of Candidate"
    for one in found:
        if np.shape(one.pose) != (3,) or not np.isfinite(one.pose).all():
            return f"found a pose {np.asarray(one.pose).tolist()}, allowed: (3,) finite numbers"
        if not 0.0 <= one.score <= 1.0:
            return f"found a score of {one.score}, allowed: 0 to 1"
    scores = [one.score for one in found]
    return f"found scores {scores}, allowed: the best first" if scores != sorted(scores, reverse=True) else ""


def best_place(query: PlaceQuery, search: PlaceSearch) -> Hypothesis | None:
    """The best pose of the newest scan by all that `search` proposes; None if nothing is good enough."""
    found = search.propose(query)
    if not type(search).__module__.startswith("sixthsense."):
        for one in found:
            check_returned("place_search", "propose", one, Candidate, pose=(3,))
    return judged(query.scans, followed_back(query.travelled_m, query.key), found) if found else None


def proposed(
    scans: PlacedScans,
    key: int,
    travelled_m: Array,
    places: KnownPlaces,
    expected: ExpectedPoses,
    min_score: float,
    least_points: int = LEAST_POINTS,
) -> list[Candidate]:
    """Different places where what was seen on the last metres up to scan `key` may be, the best score first."""
    keys = of_last_metres(travelled_m, key)
    near, range_m = surfaces_around(scans, keys, between(scans.poses[key], scans.poses[keys]))
    if len(near) < least_points:
        return []
    points, looks = _thinned(near), []
    for place in likeliest(places, expected, appearance(near)):
        window = expected.window(place)
        if window is not None:
            looks.append((place, places.submap(place, range_m), window))
    top, least = 0.0, min_score * scans.usual_agreement
    for _, submap, window in looks:
        best = peaks(submap, points, window, max(least, top), PLACE, most=1)
        top = max(top, float(best[0, 0]) if len(best) else 0.0)
    # What is worth a comparison is known only now, and most searches stop at this test.
    if top < least:
        return []
    found: list[Candidate] = []
    for place, submap, window in looks:
        rows, known = peaks(submap, points, window, _AS_GOOD * top, PLACE), places.surroundings(place)
        placed = compose(places.anchors[place], rows[:, 1:])
        found += [Candidate(pose, score, known) for pose, score in zip(placed, rows[:, 0].tolist(), strict=True)]
    return distinct(found)


def likeliest(places: KnownPlaces, expected: ExpectedPoses, look: Array) -> list[int]:
    """Places that look most like `look` (BINS,) does, and that the scan is likely near; some metres apart."""
    anchors = places.anchors
    if not len(anchors):
        return []
    alike = places.looks @ look
    square = (expected.poses[:, :2] ** 2).sum(axis=1) / (expected.sigma_m**2 + REACH_M**2)
    score = (alike - alike.mean()) / max(float(alike.std()), 1e-3)
    score -= 0.5 * (FREEDOM + 2.0) * np.log1p(square / FREEDOM)
    chosen: list[int] = []
    for place in np.argsort(-score, kind="stable").tolist():
        gap = anchors[chosen, :2] - anchors[place, :2]
        if (np.hypot(gap[:, 0], gap[:, 1]) > REACH_M).all():
            chosen.append(place)
            if len(chosen) == _CANDIDATES:
                break
    return chosen


def judged(scans: PlacedScans, keys: NDArray[np.int64], candidates: Sequence[Candidate]) -> Hypothesis:
    """The candidate, of at least one, that the scans `keys` explain best, and whether another one is nearly as good."""
    if len(candidates) > _MOST_COMPARED:
        return Hypothesis(candidates[0].pose, candidates[0].known, True)
    found = evidence_of(scans, keys, np.array([c.pose for c in candidates]), [c.known for c in candidates])
    said = sorted(zip(found, candidates, strict=True), key=lambda each: -each[0].weight)
    most, best = said[0]
    others = [other for other, _ in said[1:] if not is_same_place(most.pose, other.pose)]
    return Hypothesis(most.pose, best.known, not all(most.is_clearly_better(other) for other in others))


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


def of_last_metres(travelled_m: Array, key: int) -> NDArray[np.int64]:
    """The scans of the last metres before `key`, and itself; `travelled_m` (K,) is at each."""
    return np.flatnonzero(travelled_m[: key + 1] > travelled_m[key] - RECENT_M)


def surfaces_around(scans: PlacedScans, keys: NDArray[np.int64], at: Array) -> tuple[Array, float]:
    """(N, 4) surfaces of scans in the frame of their poses `at` (n, 3), and how far returns are at most.

    Where there is too little nearby, all that is seen counts.
    """
    near = surfaces(scans.store.returns, keys, at, _RECENT_VOXEL_M)
    if len(near) >= LEAST_POINTS:
        return near, NEAR_M
    return surfaces(scans.store.returns, keys, at, _RECENT_VOXEL_M, math.inf), math.inf


def _thinned(found: Array) -> Array:
    """(N, 2) points of surfaces (M, 4), as many as are searched for."""
    rows = np.linspace(0, len(found) - 1, min(len(found), _MOST_POINTS)).astype(np.int64)
    return np.ascontiguousarray(found[rows, :2])


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


class Vote(NamedTuple):
    """A place that was verified."""

    key: int
    pose: Array
    """(3,) of that scan, in the frame of what is known"""
    travelled_m: float
    links: list[tuple[Alignments, int]]


class Votes:
    """The votes of the last metres."""

    def __init__(self, scans: PlacedScans) -> None:
        self._scans = scans
        self._votes: list[Vote] = []

    def agreeing(self, vote: Vote) -> list[Vote]:
        """Count a vote: those that say the same, if they are far enough apart and more than half; otherwise none."""
        lasting = [each for each in self._votes if vote.travelled_m - each.travelled_m < BACK_M]
        self._votes = [*lasting, vote]
        agreeing = [each for each in self._votes if self._agree(each, vote)]
        span = vote.travelled_m - agreeing[0].travelled_m
        if span < NEW_M or 2 * len(agreeing) <= len(self._votes):
            return []
        self._votes = []
        return agreeing

    def _agree(self, one: Vote, newest: Vote) -> bool:
        """Whether two votes say the same of the newest scan's pose."""
        poses = self._scans.poses
        said = compose(one.pose, between(poses[one.key], poses[newest.key]))
        return bool(NEAR.same(between(said, newest.pose)))
