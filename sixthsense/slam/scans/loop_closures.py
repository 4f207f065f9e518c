"""LoopClosures: old places that the robot is at again.

How uncertain the newest keyframe is relative to an old one, along the graph, decides what is done. One that is certain
is linked directly. Uncertain ones are searched by branch and bound in submaps of one pass, for all places that look
alike. One is believed if the scans of the last metres fit it clearly better than any other, and if another vote some
metres later, by other scans, agrees. Until then the robot drives on. At the end of a log no vote follows: there the
last scans alone are searched for, and all of them must align. A loop closure that later ones contradict is taken back.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.config.sections import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between
from sixthsense.slam.estimators.thinning import Thinning
from sixthsense.slam.front_end import LoopClosureCounts
from sixthsense.slam.scans.graph import LINKS, M_PER_RAD, REACH_M, Keys, ScanGraph
from sixthsense.slam.scans.known_places import BACK_M, CARRIED_M, KnownPlaces
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.scans.place_search import (
    LEAST_SCANS,
    NEW_M,
    SIGMAS,
    ExpectedPoses,
    Hypothesis,
    PlaceQuery,
    PlaceSearch,
    Votes,
    best_place,
)

_PERIOD_M = 0.6  # of travel between two looks for loop closures
_CERTAIN_M, _CERTAIN_RAD = 0.3, 0.1  # sigmas below which a keyframe is linked without a search
_DRIFT_M, _DRIFT_RAD = 0.018, 0.0073  # sigmas that a chain of tracked keyframes adds, per square root of travel in m
_CONTRADICTION = 60.0  # squared Mahalanobis distance of a link that contradicts the graph, 3 degrees of freedom


class LoopClosures:
    """Finds old places, and links keyframes to them.

    A link to an old keyframe belongs to the last loop closure, which made its pose known.
    """

    def __init__(self, config: ScansConfig, graph: ScanGraph, search: PlaceSearch) -> None:
        self._graph, self._search, self._thinning = graph, search, Thinning()
        self._min_score = config.min_score
        self._places = KnownPlaces(graph)
        self._votes = Votes(graph)
        self._looked_m, self._search_from_m = 0.0 if config.loop_closures else math.inf, 0.0
        self._uncertain: tuple[Keys, tuple[Array, Array]] | None = None
        """old keyframes relative to which the newest one is uncertain, and its sigmas, if a search is due"""
        self._refused = 0
        """places that looked right, and were refused"""
        self._accepted = 0
        """loop closures accepted so far"""
        self._standing: list[int] = []
        """numbers of those that were not taken back"""

    @property
    def counts(self) -> LoopClosureCounts:
        """What the search has come to."""
        found = len(self._standing)
        return LoopClosureCounts(found, self._refused, self._accepted - found)

    @property
    def latest(self) -> int:
        """Number of the last loop closure that stands; -1 for none."""
        return self._standing[-1] if self._standing else -1

    def moved(self, cov: Array, is_carried: bool) -> None:
        """Record the motion to the newest keyframe; `cov` (3, 3) is of its error, by scans and odometry."""
        position, heading = float(np.linalg.eigvalsh(cov[:2, :2])[-1]), float(cov[2, 2])
        if is_carried:
            self._graph.moved(CARRIED_M, position, heading)
            return
        step = between(*self._graph.poses[-2:])
        travel_m = math.hypot(step[0], step[1]) + M_PER_RAD * abs(step[2])
        # Scans have errors in common with those that they are aligned with, which add up.
        self._graph.moved(travel_m, position + _DRIFT_M**2 * travel_m, heading + _DRIFT_RAD**2 * travel_m)

    def near(self, key: int) -> Keys:
        """Old keyframes to link the newest one to: around those of the last; every 0.6 m of travel all certain ones."""
        graph, self._uncertain = self._graph, None
        near, travelled_m = graph.near_linked(key), float(graph.travelled_m[key])
        if travelled_m - self._looked_m < _PERIOD_M:
            return near
        self._looked_m = travelled_m
        certain, self._uncertain = self._old(key)
        return graph.nearest(key, np.union1d(near, certain))

    def look(self, key: int) -> None:
        """Search for a loop closure, every 0.6 m of travel, and thin the graph."""
        graph = self._graph
        if self._uncertain is not None and graph.travelled_m[key] >= self._search_from_m:
            self._search_among(key, *self._uncertain)
        old_links = graph.old_links()
        # New territory stays bound to the keyframes before it, and a loop to those that closed it.
        leaving = self._thinning.leaving(
            graph.poses, graph.is_kept, lambda k: bool(old_links[k : k + LINKS + 1].min() < 2)
        )
        if leaving:
            closing = graph.links["ends"][graph.links["closes"]].ravel()
            graph.take_out(np.setdiff1d(leaving, closing).tolist())

    def look_at_end(self) -> None:
        """Look for a loop closure with the last scans alone, which are all that the place where a log ends has."""
        key = self._graph.count - 1
        _, (uncertain, sigmas) = self._old(key)
        found = self._best_place(key, uncertain, sigmas, LEAST_SCANS)
        if found is not None and not found.is_ambiguous:
            links = [each for each in found.evidence.links if len(each.targets)]
            if len(links) == LEAST_SCANS:
                self.close(Alignments.joined(links))

    def _search_among(self, key: int, uncertain: Keys, sigmas: tuple[Array, Array]) -> None:
        graph, found = self._graph, self._best_place(key, uncertain, sigmas)
        if found is None:
            return
        if found.is_ambiguous:
            self._refused += 1
            self._search_from_m = float(graph.travelled_m[key]) + NEW_M
        elif agreeing := self._votes.agreeing(key, found.evidence):
            links = Alignments.joined([vote.links for vote in agreeing])
            _, first = np.unique(np.column_stack([links.targets, links.sources]), axis=0, return_index=True)
            self.close(links.rows(np.sort(first)))  # each pair once

    def _old(self, key: int) -> tuple[Keys, tuple[Keys, tuple[Array, Array]]]:
        """Old keyframes relative to which one is certain; those where it is not, and its sigmas relative to all."""
        old = self._graph.old(key)
        sigma_m, sigma_rad = self._graph.sigmas(key)
        is_certain = (sigma_m[old] < _CERTAIN_M) & (sigma_rad[old] < _CERTAIN_RAD)
        return old[is_certain], (old[~is_certain], (sigma_m, sigma_rad))

    def _best_place(self, key: int, old: Keys, sigmas: tuple[Array, Array], last: int = 0) -> Hypothesis | None:
        """The best place of a keyframe among old ones, by the scans of the last metres or by the `last` ones alone.

        One that is not where the robot is expected is sought among all that is known: where rooms are alike it is
        ambiguous, though none of the others is where the robot may be.
        """
        graph, travelled_m = self._graph, self._graph.travelled_m
        # Places are judged by all that is known there: without the certain keyframes the true one would have no say.
        # Not by the scans of the last metres: they overlap those that are placed, and would agree with any place.
        passed = np.flatnonzero(graph.is_kept & (travelled_m[key] - travelled_m > BACK_M + REACH_M))
        known = np.union1d(old, passed)
        self._places.seek(old, known)
        keys = self._places.keys
        expected = ExpectedPoses(between(graph.poses[keys], graph.poses[key]), sigmas[0][keys], sigmas[1][keys])
        query = PlaceQuery(graph, key, self._places, expected, self._min_score, last)
        found = best_place(query, self._search) if len(keys) else None
        if found is None or found.is_ambiguous or self._is_expected(key, found, sigmas[0]):
            return found
        self._places.seek(known, known)
        return best_place(query._replace(expected=ExpectedPoses.anywhere(len(self._places.keys))), self._search)

    def _is_expected(self, key: int, found: Hypothesis, sigma_m: Array) -> bool:
        """Whether a place is where keyframe `key` is expected, by the sigmas relative to the scans that show it."""
        off = between(self._graph.poses[key], found.evidence.pose)
        shown_by = Alignments.joined(found.evidence.links).targets
        return not len(shown_by) or math.hypot(off[0], off[1]) <= SIGMAS * float(sigma_m[shown_by].max())

    def close(self, links: Alignments) -> None:
        """Close a loop with the links of a place.

        A loop closure that contradicts the graph, in the median of its links, is taken back, with all links that
        followed from it.
        """
        graph = self._graph
        self._standing.append(self._accepted)
        self._accepted += 1
        graph.give(links, np.ones(len(links.targets), dtype=np.bool_), self._standing[-1], closes=True)
        while self._standing:
            own = graph.links[graph.links["closes"]]
            squares = graph.squares(own)
            medians = [float(np.median(squares[own["closure"] == number])) for number in self._standing]
            if max(medians) <= _CONTRADICTION:
                break
            undone = self._standing.pop(int(np.argmax(medians)))
            graph.remove(graph.links["closure"] == undone)
        self._places.forget()
