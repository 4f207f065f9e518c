"""Search of a scan's place: among earlier passes, or in a map.

What was seen on the last metres is searched by branch and bound. Visibility judges the places that are found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.pipeline import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.evidence import BACK_M, OldPass, PlacedScans, Surroundings, evidence_of, followed_back
from sixthsense.slam.scans.graph import REACH_M, ScanGraph
from sixthsense.slam.scans.places import PLACE, VOXEL_M, Pyramid, Window, peaks, pyramid, submap_points

_RECENT_M = 6.0  # travel of the submap that is searched for
_RECENT_VOXEL_M = 0.2  # of these points; those of old submaps are denser
LEAST_POINTS = 60
"""without as many points of the last metres there is no search"""
MOST_POINTS = 200
_ANCHORS_APART_M, _HALF_M = 3.0, 5.0  # travel between the anchors of old submaps, and along each of them to either side
_CANDIDATES, _CANDIDATES_APART_M = 8, 4.0
SIGMAS = 2.0  # of the window that is searched
_MARGIN_M, _MARGIN_RAD = 1.5, 0.12  # beyond these
_MOST_RAD = 0.6
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


def recent_points(scans: PlacedScans, key: int, travelled_m: Array) -> Array:
    """(N, 2) points of the scans of the last metres, in the frame of the newest, `key`; `travelled_m` (K,) at each."""
    keys = of_last_metres(travelled_m, key)
    points = submap_points(scans.store.returns, keys, between(scans.poses[key], scans.poses[keys]), _RECENT_VOXEL_M)
    if len(points) > MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, MOST_POINTS).astype(np.int64)]
    return points


class PlaceSearch:
    """Keeps submaps of earlier passes, and searches them."""

    def __init__(self, config: ScansConfig, graph: ScanGraph) -> None:
        self._config, self._graph = config, graph
        self._submaps: dict[int, Pyramid] = {}
        """of the anchors of submaps that are complete"""

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
        points = recent_points(self._graph, key, travelled_m) if len(anchors) else np.zeros((0, 2))
        if len(points) < LEAST_POINTS:
            return None
        looks = [self._look(key, anchor, old, (sigma_m, sigma_rad), travelled_m) for anchor in anchors]
        return best_place(self._graph, followed_back(travelled_m, key), points, looks, self._config.min_score)

    def _look(
        self, key: int, anchor: int, old: NDArray[np.int64], sigmas: tuple[Array, Array], travelled_m: Array
    ) -> Look:
        """The submap around an anchor, and where in it the keyframe may be; `sigmas` are of position and heading."""
        half_m = min(SIGMAS * float(sigmas[0][anchor]) + _MARGIN_M, self._config.search_radius_m)
        half_rad = min(SIGMAS * float(sigmas[1][anchor]) + _MARGIN_RAD, _MOST_RAD)
        frame = self._graph.poses[anchor]
        window = Window(between(frame, self._graph.poses[key]), half_m, half_rad)
        around = old[np.abs(travelled_m[old] - travelled_m[anchor]) < _HALF_M + BACK_M + REACH_M]
        cells = self._submap(anchor, travelled_m, int(old[-1]) + 1)
        return Look(cells, window, frame, OldPass(self._graph, around))

    def _anchors(self, key: int, old: NDArray[np.int64], sigma_m: Array, travelled_m: Array) -> list[int]:
        """Anchors of old submaps that the keyframe may be in, the likeliest first."""
        number = np.floor(travelled_m / _ANCHORS_APART_M)
        firsts = np.flatnonzero(np.diff(number, prepend=-1.0) > 0)
        anchors = firsts[np.isin(firsts, old)]
        off = self._graph.poses[anchors, :2] - self._graph.poses[key, :2]
        distance, sigma = np.hypot(off[:, 0], off[:, 1]), sigma_m[anchors]
        reach = np.minimum(SIGMAS * sigma, self._config.search_radius_m) + REACH_M
        possible = np.flatnonzero(distance < reach)
        order = possible[np.argsort(distance[possible] / np.maximum(sigma[possible], 0.5), kind="stable")]
        chosen: list[int] = []
        for anchor in anchors[order].tolist():
            gap = self._graph.poses[chosen, :2] - self._graph.poses[anchor, :2]
            if len(chosen) < _CANDIDATES and (np.hypot(gap[:, 0], gap[:, 1]) > _CANDIDATES_APART_M).all():
                chosen.append(anchor)
        return chosen

    def _submap(self, anchor: int, travelled_m: Array, past: int) -> Pyramid:
        """The submap around an anchor, of one pass, without keyframes from `past` on."""
        if (known := self._submaps.get(anchor)) is not None:
            return known
        keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < _HALF_M)
        is_whole, keys = bool(keys[-1] < past), keys[keys < past]
        poses = self._graph.poses
        points = submap_points(self._graph.store.returns, keys, between(poses[anchor], poses[keys]), VOXEL_M)
        cells = pyramid(points)
        if is_whole:
            self._submaps[anchor] = cells
        return cells
