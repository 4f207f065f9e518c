"""Search of a scan's place: among earlier passes, or in a map.

Earlier places are proposed by what they look like, and by how likely the robot is near them; what was seen on the last
metres is searched for there by branch and bound. Visibility judges the places that are found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.sections import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.appearance import appearance
from sixthsense.slam.scans.evidence import BACK_M, OldPass, PlacedScans, Surroundings, evidence_of, followed_back
from sixthsense.slam.scans.graph import REACH_M, ScanGraph
from sixthsense.slam.scans.places import (
    NEAR_M,
    PLACE,
    VOXEL_M,
    Pyramid,
    Window,
    peaks,
    pyramid,
    submap_points,
    surfaces,
)

_RECENT_M = 6.0  # travel of the submap that is searched for
_RECENT_VOXEL_M = 0.2  # of these points, and of what places look like; those of old submaps are denser
LEAST_POINTS = 60
"""without as many points of the last metres there is no search"""
MOST_POINTS = 200
_ANCHORS_APART_M, _HALF_M = 3.0, 5.0  # travel between the anchors of old submaps, and along each of them to either side
_CANDIDATES, _CANDIDATES_APART_M = 8, 4.0
SIGMAS = 2.0  # of a pose within a submap
_MARGIN_M, _MARGIN_RAD = 1.5, 0.12  # beyond these
_FREEDOM = 4.0  # degrees of freedom of Student's distribution of a distance: sigmas may be wrong
_AS_GOOD = 0.7  # a place with at least this part of the best score is compared with it
_MOST_COMPARED = 16  # with more places, all are taken to be alike


class Hypothesis(NamedTuple):
    """The best pose of the newest scan."""

    pose: Array
    """(3,) of the laser"""
    known: Surroundings
    """what there is around it"""
    is_ambiguous: bool
    """whether another place is nearly as good"""


class Look(NamedTuple):
    """Where a scan may be."""

    cells: Pyramid
    window: Window
    """in the frame of the cells"""
    frame: Array
    """(3,) pose of that frame"""
    known: Surroundings
    """what the scans are compared with there"""


class _Candidate(NamedTuple):
    pose: Array
    """(3,) of the newest scan"""
    score: float
    known: Surroundings


def best_place(
    scans: PlacedScans, keys: NDArray[np.int64], points: Array, looks: Sequence[Look], min_score: float
) -> Hypothesis | None:
    """The best pose of the scan `keys[0]` by all looks together; None if none is good enough.

    `points` (N, 2) are what was seen lately, in the frame of that scan's laser, and `keys` the scans of the way there,
    the newest first. A good place explains at least the share `min_score` of the points that scans usually agree in.
    """
    top, min_score = 0.0, min_score * scans.usual_agreement
    for look in looks:
        best = peaks(look.cells, points, look.window, max(min_score, top), PLACE, most=1)
        top = max(top, float(best[0, 0]) if len(best) else 0.0)
    # What is worth a comparison is known only now, and most looks end here.
    if top < min_score:
        return None
    found: list[_Candidate] = []
    for look in looks:
        rows = peaks(look.cells, points, look.window, _AS_GOOD * top, PLACE)
        placed = compose(look.frame, rows[:, 1:])
        found += [_Candidate(pose, score, look.known) for pose, score in zip(placed, rows[:, 0].tolist(), strict=True)]
    return _judged(scans, keys, _distinct(found))


def _judged(scans: PlacedScans, keys: NDArray[np.int64], candidates: list[_Candidate]) -> Hypothesis:
    """The candidate that the last scans explain best, and whether another one is nearly as good."""
    if len(candidates) > _MOST_COMPARED:
        return Hypothesis(candidates[0].pose, candidates[0].known, True)
    found = evidence_of(scans, keys, np.array([c.pose for c in candidates]), [c.known for c in candidates])
    said = sorted(zip(found, candidates, strict=True), key=lambda each: -each[0].weight)
    most, best = said[0]
    others = [other for other, _ in said[1:] if not is_same_place(most.pose, other.pose)]
    return Hypothesis(most.pose, best.known, not all(most.is_clearly_better(other) for other in others))


def _distinct(candidates: list[_Candidate]) -> list[_Candidate]:
    """Candidates of different places, the best first."""
    chosen: list[_Candidate] = []
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
    """The keyframes of the last metres before `key`, and itself; `travelled_m` (K,) is at each."""
    return np.flatnonzero(travelled_m[: key + 1] > travelled_m[key] - _RECENT_M)


def recent_surfaces(scans: PlacedScans, key: int, travelled_m: Array) -> tuple[Array, float]:
    """(N, 4) surfaces of the scans of the last metres, in the frame of the newest, `key`, and how far they are at most.

    `travelled_m` (K,) is at each keyframe. Where there is too little nearby, all that is seen counts.
    """
    keys = of_last_metres(travelled_m, key)
    return _surfaces(scans, keys, between(scans.poses[key], scans.poses[keys]), _RECENT_VOXEL_M)


def _surfaces(scans: PlacedScans, keys: NDArray[np.int64], at: Array, voxel_m: float) -> tuple[Array, float]:
    near = surfaces(scans.store.returns, keys, at, voxel_m)
    if len(near) >= LEAST_POINTS:
        return near, NEAR_M
    return surfaces(scans.store.returns, keys, at, voxel_m, math.inf), math.inf


def recent_points(scans: PlacedScans, key: int, travelled_m: Array) -> Array:
    """(N, 2) of `recent_surfaces`, thinned."""
    return thinned(recent_surfaces(scans, key, travelled_m)[0])


def thinned(found: Array) -> Array:
    """(N, 2) points of surfaces (M, 4), as many as are searched for."""
    rows = np.linspace(0, len(found) - 1, min(len(found), MOST_POINTS)).astype(np.int64)
    return np.ascontiguousarray(found[rows, :2])


class PlaceSearch:
    """Keeps what earlier places look like, and searches for the newest scan in submaps around the likeliest of them."""

    def __init__(self, config: ScansConfig, graph: ScanGraph) -> None:
        self._config, self._graph = config, graph
        self._anchors: list[int] = []
        """keyframes, one in some metres of travel; of each the submap around it is complete"""
        self._looks: list[Array] = []
        """what the places around the anchors look like"""
        self._next_m = 0.0
        """travel at which the next anchor is"""
        self._submaps: dict[tuple[int, float], Pyramid] = {}
        """of the anchors of the last look, with what their points were limited to"""

    def forget(self) -> None:
        """Draw submaps anew: the keyframes have moved."""
        self._submaps.clear()

    def best(
        self, key: int, old: NDArray[np.int64], sigma_m: Array, sigma_rad: Array, travelled_m: Array
    ) -> Hypothesis | None:
        """The best pose of keyframe `key` among the uncertain keyframes `old`; None if none is good enough.

        `sigma_m`, `sigma_rad` and `travelled_m` (K,) are of all keyframes.
        """
        self._describe(int(old[-1]) + 1 if len(old) else 0, travelled_m)
        found, range_m = recent_surfaces(self._graph, key, travelled_m)
        if len(found) < LEAST_POINTS:
            return None
        # Places are judged by all that is known there: without the certain keyframes the true one would have no say.
        # Certain by travel alone are those that overlap the placed scans themselves: they agree with any place.
        passed = self._graph.is_kept[:key] & (travelled_m[key] - travelled_m[:key] > BACK_M + REACH_M)
        known = np.union1d(old, np.flatnonzero(passed))
        looks, submaps, self._submaps = [], self._submaps, {}
        for anchor in self._likeliest(key, old, sigma_m, appearance(found)):
            window = self._window(key, anchor, float(sigma_m[anchor]), float(sigma_rad[anchor]))
            if window is not None:
                around = known[np.abs(travelled_m[known] - travelled_m[anchor]) < _HALF_M + BACK_M + REACH_M]
                place = anchor, range_m
                cells = submaps.get(place) or self._submap(anchor, old, travelled_m, range_m)
                self._submaps[place] = cells
                looks.append(Look(cells, window, self._graph.poses[anchor], OldPass(self._graph, around)))
        back = followed_back(travelled_m, key)
        return best_place(self._graph, back, thinned(found), looks, self._config.min_score)

    def _describe(self, past: int, travelled_m: Array) -> None:
        """Keep what places look like whose submaps are complete without keyframes from `past` on."""
        while past:
            anchor = int(np.searchsorted(travelled_m[:past], self._next_m))
            if anchor == past or travelled_m[anchor] + _HALF_M >= travelled_m[past]:
                return
            keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < _HALF_M)
            at = between(self._graph.poses[anchor], self._graph.poses[keys])
            self._anchors.append(anchor)
            self._looks.append(appearance(_surfaces(self._graph, keys, at, _RECENT_VOXEL_M)[0]))
            self._next_m = float(travelled_m[anchor]) + _ANCHORS_APART_M

    def _likeliest(self, key: int, old: NDArray[np.int64], sigma_m: Array, look: Array) -> list[int]:
        """Anchors of places that look most like `look` (BINS,) does, and that the keyframe is likely near."""
        rows = np.flatnonzero(np.isin(self._anchors, old))
        if not len(rows):
            return []
        anchors = np.array(self._anchors)[rows]
        alike = np.array([self._looks[k] for k in rows.tolist()]) @ look
        off = self._graph.poses[anchors, :2] - self._graph.poses[key, :2]
        square = (off**2).sum(axis=1) / (sigma_m[anchors] ** 2 + REACH_M**2)
        score = (alike - alike.mean()) / max(float(alike.std()), 1e-3)
        score -= 0.5 * (_FREEDOM + 2.0) * np.log1p(square / _FREEDOM)
        chosen: list[int] = []
        for anchor in anchors[np.argsort(-score, kind="stable")].tolist():
            gap = self._graph.poses[chosen, :2] - self._graph.poses[anchor, :2]
            if len(chosen) < _CANDIDATES and (np.hypot(gap[:, 0], gap[:, 1]) > _CANDIDATES_APART_M).all():
                chosen.append(anchor)
        return chosen

    def _window(self, key: int, anchor: int, sigma_m: float, sigma_rad: float) -> Window | None:
        """Where in the submap around an anchor the keyframe may be; None if it is nowhere there."""
        middle = between(self._graph.poses[anchor], self._graph.poses[key])
        half_m = SIGMAS * sigma_m + _MARGIN_M
        low, high = np.maximum(middle[:2] - half_m, -_HALF_M), np.minimum(middle[:2] + half_m, _HALF_M)
        if (low > high).any():
            return None
        half_rad = min(SIGMAS * sigma_rad + _MARGIN_RAD, math.pi)
        return Window(np.array([*(0.5 * (low + high)), middle[2]]), 0.5 * float((high - low).max()), half_rad)

    def _submap(self, anchor: int, old: NDArray[np.int64], travelled_m: Array, range_m: float) -> Pyramid:
        """The submap around an anchor, of one pass: what can be seen on the last metres to any of its poses.

        A robot that comes the other way sees what lay behind it.
        """
        poses = self._graph.poses
        keys = np.flatnonzero(np.abs(travelled_m[: old[-1] + 1] - travelled_m[anchor]) < _HALF_M + _RECENT_M)
        at = between(poses[anchor], poses[keys])
        return pyramid(submap_points(self._graph.store.returns, keys, at, VOXEL_M, range_m))
