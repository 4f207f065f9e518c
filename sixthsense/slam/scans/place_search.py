"""Search of a key scan's place in submaps of earlier passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.scans import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.slam.scans.branch_and_bound import Excluded, Found, Window, best_pose
from sixthsense.slam.scans.graph import ScanGraph
from sixthsense.slam.scans.poses import between, compose
from sixthsense.slam.scans.submap import Pyramid, pyramid, submap_points

_RECENT_M = 6.0  # travel of the submap that is searched for
_RECENT_VOXEL_M, _OLD_VOXEL_M = 0.2, 0.05
_LEAST_POINTS, _MOST_POINTS = 60, 300
_ANCHORS_APART_M, _HALF_M = 3.0, 5.0  # travel between the anchors of old submaps, and along each of them to either side
_CANDIDATES, _CANDIDATES_APART_M = 8, 4.0
_SIGMAS, _MARGIN_M, _MARGIN_RAD = 2.0, 1.5, 0.12  # of the window that is searched
_REACH_SIGMAS, _REACH_M = 2.5, 4.0  # an old place may be this far from the estimate
_MOST_SIGMA_M, _MOST_RAD = 20.0, 0.6
_AMBIGUITY, _SECOND_SCORE = 0.9, 0.5  # another place is as good with this share of the best score, and at least so much
_SAME_M, _SAME_RAD = 0.7, 0.2  # two poses are of one place


class Hypothesis(NamedTuple):
    """The best pose of the newest key scan among old submaps."""

    pose: Array
    """(3,) of the key scan, world frame"""
    old: NDArray[np.int64]
    """key scans of the submap"""
    score: float
    is_ambiguous: bool
    """whether another place is nearly as good"""


class _Submap(NamedTuple):
    anchor: int
    keys: NDArray[np.int64]
    cells: Pyramid


class _Candidate(NamedTuple):
    submap: _Submap
    window: Window
    found: Found


class PlaceSearch:
    """Keeps submaps of earlier passes, and searches them."""

    def __init__(self, config: ScansConfig, graph: ScanGraph) -> None:
        self._config, self._graph = config, graph
        self._submaps: dict[int, _Submap] = {}

    def forget(self) -> None:
        """Draw submaps anew: the key scans have moved."""
        self._submaps.clear()

    def best(
        self, key: int, old: NDArray[np.int64], sigma_m: Array, sigma_rad: Array, travelled_m: Array
    ) -> Hypothesis | None:
        """The best pose of key scan `key` among the uncertain key scans `old`; None if none is good enough.

        `sigma_m`, `sigma_rad` and `travelled_m` (K,) are of all key scans.
        """
        anchors = self._anchors(key, old, sigma_m, travelled_m)
        points = self._recent_points(key, travelled_m) if len(anchors) else np.zeros((0, 2))
        if len(points) < _LEAST_POINTS:
            return None
        candidates: list[_Candidate] = []
        for anchor in anchors:
            submap = self._submap(int(anchor), travelled_m, past=int(old[-1]) + 1)
            half_m = min(_SIGMAS * sigma_m[anchor] + _MARGIN_M, self._config.search_radius_m)
            half_rad = min(_SIGMAS * sigma_rad[anchor] + _MARGIN_RAD, _MOST_RAD)
            window = Window(between(self._graph.poses[anchor], self._graph.poses[key]), half_m, half_rad)
            top = max((c.found.score for c in candidates), default=0.0)
            found = best_pose(submap.cells, points, window, max(self._config.min_score, _AMBIGUITY * top))
            if found is not None:
                candidates.append(_Candidate(submap, window, found))
        return self._judged(candidates, points) if candidates else None

    def _anchors(self, key: int, old: NDArray[np.int64], sigma_m: Array, travelled_m: Array) -> list[int]:
        """Anchors of old submaps that the key scan may be in, the likeliest first."""
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
        """(N, 2) points of the last key scans, in the frame of the newest."""
        keys = np.flatnonzero(travelled_m[: key + 1] > travelled_m[key] - _RECENT_M)
        poses = self._graph.poses
        points = submap_points(self._graph.store.returns, keys, poses, poses[key], _RECENT_VOXEL_M)
        if len(points) > _MOST_POINTS:
            points = points[np.linspace(0, len(points) - 1, _MOST_POINTS).astype(np.int64)]
        return points

    def _submap(self, anchor: int, travelled_m: Array, past: int) -> _Submap:
        """The submap around an anchor, of one pass, without key scans from `past` on."""
        if (known := self._submaps.get(anchor)) is not None:
            return known
        keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < _HALF_M)
        is_whole, keys = bool(keys[-1] < past), keys[keys < past]
        poses = self._graph.poses
        points = submap_points(self._graph.store.returns, keys, poses, poses[anchor], _OLD_VOXEL_M)
        submap = _Submap(anchor, keys, pyramid(points))
        if is_whole:
            self._submaps[anchor] = submap
        return submap

    def _judged(self, candidates: list[_Candidate], points: Array) -> Hypothesis:
        """The best candidate, and whether another place is as good."""
        ranked = sorted(candidates, key=lambda c: -c.found.score)
        best, least = ranked[0], _AMBIGUITY * ranked[0].found.score
        poses = [compose(self._graph.poses[c.submap.anchor], c.found.pose) for c in ranked]
        off = between(poses[0], np.array(poses))
        is_elsewhere = (np.hypot(off[:, 0], off[:, 1]) > _SAME_M) | (np.abs(off[:, 2]) > _SAME_RAD)
        scores = np.array([c.found.score for c in ranked])
        ambiguous = bool((is_elsewhere & (scores > least)).any())
        if not ambiguous:
            apart = Excluded(best.found.pose, _SAME_M, _SAME_RAD)
            second = best_pose(best.submap.cells, points, best.window, max(_SECOND_SCORE, least), apart)
            ambiguous = second is not None
        return Hypothesis(poses[0], best.submap.keys, best.found.score, ambiguous)
