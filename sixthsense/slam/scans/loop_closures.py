"""LoopClosures: old places that the robot is at again.

How uncertain an old keyframe is relative to the newest one, along the graph, decides what is done. One that is certain
is linked directly. Uncertain ones are searched by branch and bound in submaps of one pass, for all places that look
alike. One is believed if the scans of the last metres say clearly more for it than for any other, if pairs of scans
align at it and agree, and if another vote some metres later, by other scans, says the same. Until then the robot drives
on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config.sections import ScansConfig
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import added, between, eigen, in_axes, inverse_covariance, largest_variance, symmetrized
from sixthsense.slam.front_end import LoopClosureCounts
from sixthsense.slam.scans.graph import M_PER_RAD, OLD_AGE, REACH_M, Closings, ScanGraph, Thinning
from sixthsense.slam.scans.place_search import (
    ANCHORS_APART_M,
    BACK_M,
    HALF_M,
    NEW_M,
    RECENT_M,
    ExpectedPoses,
    PlaceQuery,
    PlaceSearch,
    Vote,
    Votes,
    best_place,
    of_last_metres,
    surfaces_around,
    vote_for,
)
from sixthsense.slam.scans.places import BINS, VOXEL_M, Pyramid, appearance, pyramid, submap_points
from sixthsense.slam.scans.tracking import Tracked

_PERIOD_M = 0.6  # of travel between two looks for loop closures
_CERTAIN_M, _CERTAIN_RAD = 0.3, 0.1  # sigmas below which a keyframe is linked without a search
_DRIFT_M, _DRIFT_RAD = 0.018, 0.0073  # sigmas that a chain of tracked keyframes adds, per square root of travel in m
_DOUBT = 0.5  # share of the distance between scans and wheels that is doubted where they contradict each other
_BIAS_M_PER_M = 0.05  # sigma of what wheels in general are off to one side
_APART_M = 100.0  # of travel where the robot was carried: neither submap nor vote spans that


class LoopClosures:
    """Finds old places, and links keyframes to them."""

    def __init__(self, config: ScansConfig, graph: ScanGraph, search: PlaceSearch) -> None:
        self._graph, self._search = graph, search
        self.closings = Closings(graph)
        self._thinning = Thinning(graph, self.closings)
        self._min_score = config.min_score
        self._passes = Passes(graph)
        self._votes = Votes(graph)
        self._travelled = np.zeros(64)
        """(K,) m, at each keyframe"""
        self._looked_m = self._search_from_m = 0.0
        self._refused = 0
        """places that looked right, and were refused"""

    @property
    def counts(self) -> LoopClosureCounts:
        """What the search has come to."""
        undone = self.closings.undone
        return LoopClosureCounts(self.closings.accepted - undone, self._refused, undone)

    def sigmas(self, key: int) -> tuple[Array, Array]:
        """(K,) sigmas of position, m, and heading, rad, of all keyframes relative to `key`; infinite if unconnected."""
        return self._graph.uncertainty.sigmas(key, self._graph.poses)

    def of_last_metres(self, key: int) -> NDArray[np.int64]:
        """The keyframes up to `key` of the last metres, since the track last broke."""
        return of_last_metres(self._travelled, key)

    def moved(
        self, key: int, tracked: Tracked | None, odometry_information: Array, wheels: float, is_carried: bool
    ) -> None:
        """Add a keyframe after the first; `odometry_information` (3, 3) is the prior's, world axes.

        `tracked` is None where its scan tells nothing, also where the robot was carried to it; `wheels` is the factor
        of their errors of position on those of wheels in general.
        """
        if key == len(self._travelled):
            self._travelled = np.concatenate([self._travelled, np.zeros_like(self._travelled)])
        if is_carried:
            self._carried(key, np.asarray(np.linalg.inv(odometry_information), dtype=np.float64))
            return
        step = between(self._graph.poses[key - 1], self._graph.poses[key])
        travel = math.hypot(step[0], step[1]) + M_PER_RAD * abs(step[2])
        self._travelled[key] = self._travelled[key - 1] + travel
        told = np.zeros((3, 3)) if tracked is None else tracked.information
        position, heading, by_wheels = _step_variances(told, odometry_information, travel)
        if tracked is not None and tracked.has_slipped:
            position += _DOUBT**2 * float(tracked.off[:2] @ tracked.off[:2])
            heading += _DOUBT**2 * float(tracked.off[2]) ** 2
        bias_m = wheels * _BIAS_M_PER_M * min(by_wheels, 1.0) * travel
        self._graph.uncertainty.add(key - 1, key, position, heading, bias_m=bias_m)

    def _carried(self, key: int, cov: Array) -> None:
        """Add a keyframe that was not tracked; `cov` (3, 3) is of the motion to it."""
        self._travelled[key] = self._travelled[key - 1] + _APART_M
        self._graph.uncertainty.add(key - 1, key, float(np.linalg.eigvalsh(cov[:2, :2])[-1]), float(cov[2, 2]))

    def look(self, key: int) -> None:
        """From time to time, link the newest keyframe to old ones around it, and look for a loop closure."""
        if self._travelled[key] - self._looked_m >= _PERIOD_M:
            self._looked_m = float(self._travelled[key])
            self._look_around(key)
        self._thinning.look(key)

    def _look_around(self, key: int) -> None:
        old = np.flatnonzero(self._graph.is_kept[: max(self._graph.first, key - OLD_AGE)])
        if not len(old):
            return
        sigma_m, sigma_rad = self._graph.uncertainty.sigmas(key, self._graph.poses)
        is_certain = (sigma_m < _CERTAIN_M) & (sigma_rad < _CERTAIN_RAD)
        certain = self._graph.nearest(key, old[is_certain[old]])
        self.closings.link_old(key, np.setdiff1d(certain, self._graph.linked_old(key)))
        if self._travelled[key] >= self._search_from_m:
            self._search_uncertain(key, old[~is_certain[old]], sigma_m, sigma_rad)

    def _search_uncertain(self, key: int, old: NDArray[np.int64], sigma_m: Array, sigma_rad: Array) -> None:
        travelled_m = self._travelled[: self._graph.count]
        self._passes.seek(key, old, travelled_m)
        expected = self._passes.expected(key, sigma_m, sigma_rad)
        query = PlaceQuery(self._graph, key, travelled_m, self._passes, expected, self._min_score)
        found = best_place(query, self._search)
        if found is None:
            return
        if found.is_ambiguous:
            self._refused += 1
            self._search_from_m = float(self._travelled[key]) + NEW_M
            return
        vote = vote_for(self._graph, key, self._travelled, found)
        if vote is None:
            self._refused += 1
        elif self._count(vote):
            self._passes.forget()

    def _count(self, vote: Vote) -> bool:
        """Count a vote, and close the loop if enough agree; whether that was done."""
        agreeing = self._votes.agreeing(vote)
        if not agreeing:
            return False
        links = {(int(f.targets[k]), int(f.sources[k])): (f, k) for v in agreeing for f, k in v.links}
        self.closings.close(list(links.values()))
        return True


@numba.njit(cache=True, error_model="numpy")
def _step_variances(told: Array, odometry_information: Array, travel: float) -> tuple[float, float, float]:
    """Variances of position and heading of a motion, and the share of the wheels in what is known of it.

    `told` (3, 3) is the information of the scans. Their own error is a drift of what they are aligned with, too, which
    the wheels may bound. The share is that along the direction that is known least: 1 in a bare corridor.
    """
    values, axes = eigen(told)
    for k in range(3):
        values[k] = max(values[k], 0.0)
    told, root = (
        in_axes(values, axes),
        (math.sqrt(travel) * _DRIFT_M, math.sqrt(travel) * _DRIFT_M, math.sqrt(travel) * _DRIFT_RAD),
    )
    # With the root R of the drift D, told (1 + D told)^-1 = told - told R (1 + R told R)^-1 R told.
    information, bounded = added(told, odometry_information), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            bounded[i, j] = root[i] * told[i, j] * root[j] + (i == j)
    inner = inverse_covariance(bounded)
    for i in range(3):
        for j in range(3):
            for p in range(3):
                for q in range(3):
                    information[i, j] -= told[i, p] * root[p] * inner[p, q] * root[q] * told[q, j]
    cov = inverse_covariance(symmetrized(information))
    position, c, s = largest_variance(cov)
    wheels = odometry_information
    share = (c * c * wheels[0, 0] + c * s * (wheels[0, 1] + wheels[1, 0]) + s * s * wheels[1, 1]) * position
    return position, cov[2, 2], share


class OldPass(NamedTuple):
    """Old keyframes of one pass."""

    graph: ScanGraph
    keys: NDArray[np.int64]

    def partners(self, key: int, at: Array, most: int) -> NDArray[np.int64]:
        """Those whose views overlap most."""
        return self.keys[self.graph.overlapping(key, at, self.keys, REACH_M)[:most]]


class Passes:
    """Earlier passes as known places: what is around one keyframe in some metres of travel."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._all: list[int] = []
        """keyframes of the anchors, of each of which the submap around it is complete"""
        self._looks = np.zeros((64, BINS))
        """what the places around them look like"""
        self._next_m = 0.0
        """travel at which the next anchor is"""
        self._rows = np.zeros(0, dtype=np.int64)
        """anchors that are sought among"""
        self._old = self._known = self._rows
        """uncertain keyframes, and all that places are judged by"""
        self._travelled_m = np.zeros(0)
        self._submaps: dict[tuple[int, float], Pyramid] = {}
        """of this search: by an anchor, and what its points were limited to"""
        self._earlier = self._submaps
        """of the one before"""

    @property
    def _keys(self) -> NDArray[np.int64]:
        return np.array(self._all, dtype=np.int64)[self._rows]

    @property
    def anchors(self) -> Array:
        """(n, 3) poses of the keyframes."""
        return np.asarray(self._graph.poses[self._keys])

    @property
    def looks(self) -> Array:
        """(n, BINS) what the places look like."""
        return self._looks[self._rows]

    def seek(self, key: int, old: NDArray[np.int64], travelled_m: Array) -> None:
        """Seek keyframe `key` among the uncertain keyframes `old`; `travelled_m` (K,) is at all of them."""
        self._describe(int(old[-1]) + 1 if len(old) else 0, travelled_m)
        self._rows = np.flatnonzero(np.isin(self._all, old))
        # Places are judged by all that is known there: without the certain keyframes the true one would have no say.
        # Certain by travel alone are those that overlap the placed scans themselves: they agree with any place.
        passed = self._graph.is_kept[:key] & (travelled_m[key] - travelled_m[:key] > BACK_M + REACH_M)
        self._old, self._known = old, np.union1d(old, np.flatnonzero(passed))
        self._travelled_m, self._earlier, self._submaps = travelled_m, self._submaps, {}

    def expected(self, key: int, sigma_m: Array, sigma_rad: Array) -> ExpectedPoses:
        """Where a keyframe is, by the poses and their sigmas (K,) relative to it."""
        keys = self._keys
        return ExpectedPoses(between(self._graph.poses[keys], self._graph.poses[key]), sigma_m[keys], sigma_rad[keys])

    def forget(self) -> None:
        """Draw submaps anew: the keyframes have moved."""
        self._submaps = {}

    def surroundings(self, place: int) -> OldPass:
        """The keyframes that are known along the way there."""
        off_m = self._travelled_m[self._known] - self._travelled_m[self._keys[place]]
        return OldPass(self._graph, self._known[np.abs(off_m) < HALF_M + BACK_M + REACH_M])

    def submap(self, place: int, range_m: float) -> Pyramid:
        """The submap around an anchor, of one pass: what can be seen on the last metres to any of its poses.

        A robot that comes the other way sees what lay behind it.
        """
        which = int(self._keys[place]), range_m
        self._submaps[which] = self._earlier.get(which) or self._drawn(*which)
        return self._submaps[which]

    def _drawn(self, anchor: int, range_m: float) -> Pyramid:
        poses, past = self._graph.poses, int(self._old[-1]) + 1
        keys = np.flatnonzero(np.abs(self._travelled_m[:past] - self._travelled_m[anchor]) < HALF_M + RECENT_M)
        at = between(poses[anchor], poses[keys])
        return pyramid(submap_points(self._graph.store.returns, keys, at, VOXEL_M, range_m))

    def _describe(self, past: int, travelled_m: Array) -> None:
        """Keep what places look like whose submaps are complete without keyframes from `past` on."""
        while past:
            anchor = int(np.searchsorted(travelled_m[:past], self._next_m))
            if anchor == past or travelled_m[anchor] + HALF_M >= travelled_m[past]:
                return
            keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < HALF_M)
            at = between(self._graph.poses[anchor], self._graph.poses[keys])
            if len(self._all) == len(self._looks):
                self._looks = np.concatenate([self._looks, np.zeros_like(self._looks)])
            self._looks[len(self._all)] = appearance(surfaces_around(self._graph, keys, at)[0])
            self._all.append(anchor)
            self._next_m = float(travelled_m[anchor]) + ANCHORS_APART_M
