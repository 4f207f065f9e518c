"""Search of a keyframe's place in submaps of earlier passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.scans import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.slam.scans.branch_and_bound import Apart, Window, peaks
from sixthsense.slam.scans.evidence import evidence_of, followed_back
from sixthsense.slam.scans.graph import ScanGraph
from sixthsense.slam.scans.poses import between, compose
from sixthsense.slam.scans.submap import Pyramid, pyramid, submap_points

RECENT_M = 6.0
"""travel of the submap that is searched for"""
_RECENT_VOXEL_M, _OLD_VOXEL_M = 0.2, 0.05
_LEAST_POINTS, _MOST_POINTS = 60, 300
_ANCHORS_APART_M, _HALF_M = 3.0, 5.0  # travel between the anchors of old submaps, and along each of them to either side
_CANDIDATES, _CANDIDATES_APART_M = 8, 4.0
_SIGMAS, _MARGIN_M, _MARGIN_RAD = 2.0, 1.5, 0.12  # of the window that is searched
_REACH_SIGMAS, _REACH_M = 2.5, 4.0  # an old place may be this far from the estimate
_MOST_SIGMA_M, _MOST_RAD = 20.0, 0.6
_AS_GOOD = 0.7  # a place with at least this part of the best score is compared with it
_MOST_COMPARED = 16  # with more places, all are taken to be alike
_BACK_M = 16.0  # travel beyond the submap whose old keyframes are compared
_APART = Apart(0.7, 0.2)  # two poses that are nearer are of one place


class Hypothesis(NamedTuple):
    """The best pose of the newest keyframe among old submaps."""

    pose: Array
    """(3,) of the keyframe, world frame"""
    old: NDArray[np.int64]
    """keyframes of its pass around it"""
    score: float
    is_ambiguous: bool
    """whether another place is nearly as good"""


class _Submap(NamedTuple):
    anchor: int
    keys: NDArray[np.int64]
    cells: Pyramid


class _Candidate(NamedTuple):
    submap: _Submap
    pose: Array
    """(3,) of the newest keyframe, world frame"""
    score: float


class PlaceSearch:
    """Keeps submaps of earlier passes, and searches them."""

    def __init__(self, config: ScansConfig, graph: ScanGraph) -> None:
        self._config, self._graph = config, graph
        self._submaps: dict[int, _Submap] = {}

    def forget(self) -> None:
        """Draw submaps anew: the keyframes have moved."""
        self._submaps.clear()

    def best(
        self,
        key: int,
        old: NDArray[np.int64],
        sigma_m: Array,
        sigma_rad: Array,
        travelled_m: Array,
    ) -> Hypothesis | None:
        """The best pose of keyframe `key` among the uncertain keyframes `old`; None if none is good enough.

        `sigma_m`, `sigma_rad` and `travelled_m` (K,) are of all keyframes.
        """
        anchors = self._anchors(key, old, sigma_m, travelled_m)
        points = self._recent_points(key, travelled_m) if len(anchors) else np.zeros((0, 2))
        if len(points) < _LEAST_POINTS:
            return None
        looks = [self._look(key, anchor, int(old[-1]) + 1, (sigma_m, sigma_rad), travelled_m) for anchor in anchors]
        top, least = 0.0, self._config.min_score
        for submap, window in looks:
            best = peaks(submap.cells, points, window, max(least, top), _APART, most=1)
            top = max(top, float(best[0, 0]) if len(best) else 0.0)
        # What is worth a comparison is known only now, and most looks end here.
        if top < least:
            return None
        candidates: list[_Candidate] = []
        for submap, window in looks:
            found = peaks(submap.cells, points, window, _AS_GOOD * top, _APART)
            placed = compose(self._graph.poses[submap.anchor], found[:, 1:])
            candidates += [
                _Candidate(submap, pose, score) for pose, score in zip(placed, found[:, 0].tolist(), strict=True)
            ]
        return self._judged(key, old, _distinct(candidates, _AS_GOOD * top), travelled_m)

    def _look(
        self, key: int, anchor: int, past: int, sigmas: tuple[Array, Array], travelled_m: Array
    ) -> tuple[_Submap, Window]:
        """The submap around an anchor, and where in it the keyframe may be; `sigmas` are of position and heading."""
        half_m = min(_SIGMAS * float(sigmas[0][anchor]) + _MARGIN_M, self._config.search_radius_m)
        half_rad = min(_SIGMAS * float(sigmas[1][anchor]) + _MARGIN_RAD, _MOST_RAD)
        window = Window(between(self._graph.poses[anchor], self._graph.poses[key]), half_m, half_rad)
        return self._submap(anchor, travelled_m, past), window

    def _anchors(self, key: int, old: NDArray[np.int64], sigma_m: Array, travelled_m: Array) -> list[int]:
        """Anchors of old submaps that the keyframe may be in, the likeliest first."""
        number = np.floor(travelled_m / _ANCHORS_APART_M)
        firsts = np.flatnonzero(np.diff(number, prepend=-1.0) > 0)
        anchors = firsts[np.isin(firsts, old)]
        off = self._graph.poses[anchors, :2] - self._graph.poses[key, :2]
        distance, sigma = np.hypot(off[:, 0], off[:, 1]), sigma_m[anchors]
        reach = np.minimum(_REACH_SIGMAS * sigma, self._config.search_radius_m) + _REACH_M
        possible = np.flatnonzero((distance < reach) & (sigma < _MOST_SIGMA_M))
        order = possible[np.argsort(distance[possible] / np.maximum(sigma[possible], 0.5), kind="stable")]
        chosen: list[int] = []
        for anchor in anchors[order].tolist():
            gap = self._graph.poses[chosen, :2] - self._graph.poses[anchor, :2]
            if len(chosen) < _CANDIDATES and (np.hypot(gap[:, 0], gap[:, 1]) > _CANDIDATES_APART_M).all():
                chosen.append(anchor)
        return chosen

    def _recent_points(self, key: int, travelled_m: Array) -> Array:
        """(N, 2) points of the last keyframes, in the frame of the newest."""
        keys = np.flatnonzero(travelled_m[: key + 1] > travelled_m[key] - RECENT_M)
        poses = self._graph.poses
        points = submap_points(self._graph.store.returns, keys, between(poses[key], poses[keys]), _RECENT_VOXEL_M)
        if len(points) > _MOST_POINTS:
            points = points[np.linspace(0, len(points) - 1, _MOST_POINTS).astype(np.int64)]
        return points

    def _submap(self, anchor: int, travelled_m: Array, past: int) -> _Submap:
        """The submap around an anchor, of one pass, without keyframes from `past` on."""
        if (known := self._submaps.get(anchor)) is not None:
            return known
        keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < _HALF_M)
        is_whole, keys = bool(keys[-1] < past), keys[keys < past]
        poses = self._graph.poses
        points = submap_points(self._graph.store.returns, keys, between(poses[anchor], poses[keys]), _OLD_VOXEL_M)
        submap = _Submap(anchor, keys, pyramid(points))
        if is_whole:
            self._submaps[anchor] = submap
        return submap

    def _judged(
        self,
        key: int,
        old: NDArray[np.int64],
        candidates: list[_Candidate],
        travelled_m: Array,
    ) -> Hypothesis | None:
        """The candidate that the last scans explain best, and whether another one is nearly as good."""
        if len(candidates) > _MOST_COMPARED:
            best = candidates[0]
            return Hypothesis(best.pose, best.submap.keys, best.score, True)
        travelled = travelled_m[old]
        anchors = [travelled_m[c.submap.anchor] for c in candidates]
        olds = [old[np.abs(travelled - anchor) < _HALF_M + _BACK_M] for anchor in anchors]
        places = np.array([c.pose for c in candidates])
        found = evidence_of(self._graph, followed_back(travelled_m, key), places, olds)
        said = sorted(zip(found, candidates, olds, strict=True), key=lambda each: -each[0].weight)
        most, best, around = said[0]
        others = [e for e, *_ in said[1:] if not _is_same(most.pose, e.pose)]
        if best.score < self._config.min_score:
            return None
        ambiguous = not all(most.is_clearly_better(other) for other in others)
        return Hypothesis(most.pose, around, best.score, ambiguous)


def _distinct(candidates: list[_Candidate], least: float) -> list[_Candidate]:
    """Candidates of different places with at least this score, the best first."""
    chosen: list[_Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.score):
        if candidate.score < least or len(chosen) > _MOST_COMPARED:
            break
        if not any(_is_same(candidate.pose, known.pose) for known in chosen):
            chosen.append(candidate)
    return chosen


def _is_same(one: Array, other: Array) -> bool:
    off = between(one, other)
    return bool(np.hypot(off[0], off[1]) < _APART.distance_m and abs(off[2]) < _APART.turn_rad)
