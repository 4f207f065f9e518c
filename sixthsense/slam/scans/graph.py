"""The graph of keyframes: their poses, and each link once, as the estimator was given it.

Thinning: where enough keyframes show a place from much the same pose, later ones leave the graph.

A robot that comes back to the same rooms all day adds keyframes for ever, and says nothing new by them. Keeping the
poses that are there already, once a place is known, is the reduced pose graph of Johannsson, Kaess, Fallon and Leonard,
ICRA 2013. A keyframe leaves some time after it was made. Its links are lost, so that nothing is counted twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import between, compose, conjugate, largest_variance, move_covariance, triple, whitenings
from sixthsense.slam.estimators import Link, Smoother
from sixthsense.slam.front_end import PoseLinks
from sixthsense.slam.scans.links import NEAR_GATE_M, WIDE_GATE_M, Alignments, align_with, covariances
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import Usual
from sixthsense.slam.scans.uncertainty import UncertaintyGraph

Keys = NDArray[np.int64]
NO_KEYS: Keys = np.zeros(0, dtype=np.int64)

LINKS = 4  # of a keyframe to those before it, and to old ones at most
OLD_AGE = 25  # keyframes; nearer ones are of the same pass
_AROUND = 8  # keyframes before the newest whose old partners are followed, and to either side of each partner
REACH_M, REACH_RAD = 4.0, 2.0  # between scans whose views overlap
M_PER_RAD = 0.5  # what a turn counts as a distance
AGREEMENT = 0.75  # least share of hits among hits and views through, of the usual one
_PERIOD = 10  # keyframes between two times that all poses are read, and that leave at a time: each costs a solution
_WEIGHTED = 0.777  # mean of a chi-square of 3 degrees of freedom by the weights of the loss, over that without
_FACTOR_LINKS = 2000  # links at the end that the variance factor is estimated from
_FACTOR_PRIOR = 10.0  # degrees of freedom of a prior factor of 1
LOSS = 4.0  # scale of the Cauchy loss, in whitened error of three coordinates: 2.4 is usual for one (95 % efficiency)


class LinkKind(Enum):
    """What a link joins."""

    ONE_PASS = "keyframes of one pass"
    OLD = "a keyframe and an old one, of another pass"


class KeyframeLink(NamedTuple):
    """The relative pose of two keyframes, as it was given to the estimator."""

    target: int
    source: int
    pose: Array
    """(3,) of the source's laser in the frame of the target's"""
    cov: Array
    """(3, 3) of its error, axes of the target's laser"""
    kind: LinkKind
    scale: float
    """what the covariance by its returns was multiplied with"""
    closure: int | None
    """the loop closure that a link to an old keyframe follows from; None for one before the first"""


class ScanGraph:
    """Keyframes with their poses as the estimator has them, and the links that it was given."""

    def __init__(self, store: ScanStore, estimator: Smoother, sigma_m: float) -> None:
        """Begin empty; `sigma_m` is the least sigma of a return."""
        self.store, self.estimator = store, estimator
        self._sigma_m = sigma_m
        self._rows = np.zeros((64, 3))
        self._centres = np.zeros((64, 3))
        """middle of what each keyframe sees, in its frame, as poses without a turn"""
        self._kept_rows = np.ones(64, dtype=np.bool_)
        self._mount = np.zeros(3)
        """(3,) `T_robot_laser`"""
        self.poses, self.is_kept = self._rows[:0], self._kept_rows[:0]
        """(K, 3) `T_world_laser` of the keyframes, and (K,) which of them are in the estimator's graph; views. The
        poses of others follow their neighbours'."""
        self.count = 0
        """number of keyframes"""
        self.links: dict[int, KeyframeLink] = {}
        """by the estimator's id"""
        self._ends, self._motions = np.zeros((64, 2), dtype=np.int64), np.zeros((64, 3))
        self._roots, self._are_old = np.zeros((64, 3, 3)), np.zeros(64, dtype=np.bool_)
        """of the links, in the rows of their ids: keyframes, relative poses, whitenings of their errors, and kinds"""
        self._of: dict[int, list[int]] = {}
        """of a keyframe: the ids of its links to earlier ones"""
        self.uncertainty = UncertaintyGraph()
        """of the poses relative to each other: an arc for each motion, and for links to old keyframes"""
        self.usual = Usual(0.0, 0.5)
        """what scans lately had where they were tracked"""
        self.first = 0
        """index of the first keyframe since the robot was put where it is, or carried"""
        self._refreshed = 0
        """number of keyframes when all poses were read"""
        self._factors: tuple[float, float] | None = None
        """the variance factors of the links as they are and before scaling, once asked for after all poses were read"""

    @property
    def usual_agreement(self) -> float:
        """Share of the returns, of those that are judged, that scans lately agreed in where they were tracked."""
        return 1.0 - self.usual.contradicted

    def add(self, pose: Array, mount: Array) -> None:
        """Add the newest keyframe at `pose` (3,), `T_world_laser`, whose `mount` (3,) is `T_robot_laser`."""
        k = self.count
        if k == len(self._rows):
            self._rows, self._centres = _doubled(self._rows), _doubled(self._centres)
            self._kept_rows = np.concatenate([self._kept_rows, np.ones_like(self._kept_rows)])
        self._rows[k], self._mount = pose, mount
        points = self.store.returns.points[k]
        self._centres[k, :2] = points[:, :2].sum(axis=0) / max(np.count_nonzero(points[:, 2]), 1)
        self.count = k + 1
        self.poses, self.is_kept = self._rows[: k + 1], self._kept_rows[: k + 1]

    def refresh(self) -> None:
        """Take all poses from the estimator."""
        self.poses[:] = compose(self.estimator.trajectory(), self._mount)
        self._refreshed, self._factors = self.count, None

    def recent(self, key: int) -> Keys:
        """The keyframes just before a keyframe, since the robot was last carried."""
        return np.arange(max(self.first, key - LINKS), key)

    def link(self, key: int, recent: Keys, old: Keys, closure: int | None) -> list[int]:
        """Link a keyframe to recent ones and to old ones near it; ids of the links to old ones.

        Poses relative to it are known to some decimetres. All at once: each time costs the estimator a solution.
        """
        targets, is_old = np.concatenate([recent, old]), np.arange(len(recent) + len(old)) >= len(recent)
        found = align_with(self.store.returns, targets, key, self.poses, NEAR_GATE_M)
        is_good = found.agree(AGREEMENT, self.usual_agreement) & (~is_old | (found.moved_m < WIDE_GATE_M))
        good = np.flatnonzero(is_good)
        return self.give(found.rows(good), is_old[good], LOSS, closure)

    def give(self, found: Alignments, is_old: NDArray[np.bool_], loss_scale: float, closure: int | None) -> list[int]:
        """Give aligned pairs to the estimator as links, of one pass or to old keyframes; the ids of the latter."""
        if not len(is_old):
            return []
        # The links of a scan are together worth its alignment with a map of that many scans.
        sources = found.sources.tolist()
        shared_by = np.array([1.0 + len(self._of.get(key, ())) + sources.count(key) for key in sources])
        scale = self.scale()
        covs = scale * covariances(found.sums, shared_by, self._sigma_m)
        links = [
            KeyframeLink(
                target, source, pose, cov, LinkKind.OLD if old else LinkKind.ONE_PASS, scale, closure if old else None
            )
            for target, source, pose, cov, old in zip(
                found.targets.tolist(), sources, found.poses, covs, is_old.tolist(), strict=True
            )
        ]
        ids = self._add(links, [loss_scale if old else LOSS for old in is_old])
        # The newest poses have moved, and those that links lead to, which are read now; all are from time to time.
        keys = sorted({*range(max(0, self.count - LINKS - 1), self.count), *found.targets[is_old].tolist()})
        self.poses[keys] = compose(self.estimator.poses_at(keys), self._mount)
        if self.count - self._refreshed >= _PERIOD:
            self.refresh()
        return [i for i, old in zip(ids, is_old, strict=True) if old]

    def with_loss(self, ids: list[int], loss_scale: float) -> list[int]:
        """Replace links by the same ones with another loss; their new ids."""
        links = [self.links[i] for i in ids]
        self._drop(ids)
        new = self._add(links, [loss_scale] * len(links))
        self.estimator.unlink(ids)
        self.refresh()
        return new

    def remove(self, ids: list[int]) -> None:
        """Take links back."""
        self.estimator.unlink(ids)
        self._drop(ids)
        self.refresh()

    def take_out(self, keys: list[int]) -> None:
        """Take keyframes out of the estimator's graph, with their links."""
        self._drop(self.estimator.take_out(keys))
        self.uncertainty.take_out(keys)
        self.is_kept[keys] = False
        self.refresh()

    def _add(self, links: list[KeyframeLink], losses: list[float]) -> list[int]:
        given = self.robot_links(links)
        motions = [Odometry(Pose(*row), cov) for row, cov in zip(given.motions.tolist(), given.covs, strict=True)]
        ids = self.estimator.link(
            [Link(a.target, a.source, motion, loss) for a, motion, loss in zip(links, motions, losses, strict=True)]
        )
        self._tabulate(ids, links)
        for i, link in zip(ids, links, strict=True):
            self.links[i] = link
            self._of.setdefault(link.source, []).append(i)
            if link.kind is LinkKind.OLD:
                position = largest_variance(link.cov)[0]
                self.uncertainty.add(link.target, link.source, position, float(link.cov[2, 2]), i)
        return ids

    def _tabulate(self, ids: Sequence[int], links: Sequence[KeyframeLink]) -> None:
        """Keep new links as rows of arrays."""
        while ids and max(ids) >= len(self._ends):
            self._ends, self._motions = _doubled(self._ends), _doubled(self._motions)
            self._roots, self._are_old = _doubled(self._roots), _doubled(self._are_old)
        rows = np.array(ids, dtype=np.int64)
        self._ends[rows] = np.array([(link.target, link.source) for link in links], dtype=np.int64).reshape(-1, 2)
        self._motions[rows] = np.array([link.pose for link in links]).reshape(-1, 3)
        self._roots[rows] = whitenings(np.array([link.cov for link in links]).reshape(-1, 3, 3))
        self._are_old[rows] = [link.kind is LinkKind.OLD for link in links]

    def robot_links(self, links: Sequence[KeyframeLink]) -> PoseLinks:
        """Links, between poses of the robot."""
        ends = np.array([(link.target, link.source) for link in links], dtype=np.int64).reshape(-1, 2)
        mount = triple(self._mount)
        motions = [conjugate(mount, triple(link.pose)) for link in links]
        # The covariance of a link is in the axes of its target.
        covs = [move_covariance(compose(mount, (0.0, 0.0, -link.pose[2])), link.cov) for link in links]
        return PoseLinks(ends, np.array(motions).reshape(-1, 3), np.array(covs).reshape(-1, 3, 3))

    def _drop(self, ids: list[int]) -> None:
        self.uncertainty.remove(ids)
        for i in ids:
            self._of[self.links.pop(i).source].remove(i)

    def variance_factor(self) -> float:
        """What the graph's covariances are to be multiplied with, by the residuals of the last keyframes.

        The a posteriori variance of unit weight of a least-squares adjustment: the weighted sum of the squares of the
        links' whitened residuals over the redundancy, that of links less that of poses. The links of a keyframe to one
        pass count once in it: what apparent poses do not take up is an error of the same returns in all of them (a
        design effect as of samples in clusters; Kish, "Survey Sampling", 1965). The factor is 1 where the track has
        broken or the robot was carried.
        """
        return self._variance_factors()[0]

    def scale(self) -> float:
        """What the variance of returns is to be multiplied with where scans stand beside wheels.

        Where scans fit each other worse than they state, as among crooked or moved things, they count less. Where they
        fit better nothing is said: what all have in common does not show.
        """
        return max(1.0, self._variance_factors()[1])

    def _variance_factors(self) -> tuple[float, float]:
        """The variance factors of the links as the estimator has them, and before they were scaled."""
        if self.first or self.count < 2:
            return 1.0, 1.0  # the covariance of a motion that nothing has measured is as stated
        if self._factors is None:
            links = list(itertools.islice(reversed(self.links), _FACTOR_LINKS))
            sources, are_old = self._ends[links, 1], self._are_old[links]
            passes, keys = len(np.unique(2 * sources + are_old)), len(np.unique(sources))
            redundancy = 3 * passes * (1.0 - keys / max(len(links), 1))
            squares = self.squares(links)
            # Weighted as in the graph: a few wrong links say nothing of the others. Of right ones so much is left.
            squares /= _WEIGHTED * (1.0 + squares / LOSS**2)
            unscaled = squares * np.array([self.links[i].scale for i in links])
            now, before = ((float(s.sum()) + _FACTOR_PRIOR) / (redundancy + _FACTOR_PRIOR) for s in (squares, unscaled))
            self._factors = now, before
        return self._factors

    def squares(self, ids: Sequence[int]) -> Array:
        """(n,) squared Mahalanobis distances of links from the estimate."""
        rows = np.array(ids, dtype=np.int64)
        off = self._motions[rows] - between(self.poses[self._ends[rows, 0]], self.poses[self._ends[rows, 1]])
        off[:, 2] = wrap_angle(off[:, 2])
        return np.asarray(((self._roots[rows] @ off[:, :, None]) ** 2).sum(axis=(1, 2)))

    def linked_old(self, key: int) -> list[int]:
        """Old keyframes that a keyframe is linked to."""
        links = (self.links[i] for i in self._of.get(key, ()))
        return [link.target for link in links if link.kind is LinkKind.OLD]

    def near_linked(self, key: int) -> Keys:
        """Old keyframes around those that the last keyframes are linked to, the nearest first."""
        around: set[int] = set()
        for other in range(max(0, key - _AROUND), key):
            for old in self.linked_old(other):
                around.update(range(max(0, old - _AROUND), min(old + _AROUND + 1, key - OLD_AGE)))
        candidates = np.array(sorted(around), dtype=np.int64)
        return self.nearest(key, candidates[self.is_kept[candidates]])

    def nearest(self, key: int, candidates: Keys) -> Keys:
        """Those of the candidates whose views overlap that of a keyframe most, by their poses."""
        off = between(self.poses[key], self.poses[candidates])
        distance, turn = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
        near = np.flatnonzero((distance < REACH_M) & (turn < REACH_RAD))
        order = np.argsort(distance[near] + M_PER_RAD * turn[near], kind="stable")
        return candidates[near[order][:LINKS]]

    def overlapping(self, key: int, pose: Array, candidates: Keys, reach_m: float) -> Keys:
        """Rows of `candidates` whose views overlap that of keyframe `key` if it is at `pose` (3,), the most first.

        What counts is the distance between the centres of what the scans see: a laser that looks forward sees from
        either end of a corridor what is between. The pose and those in `poses` are of one frame.
        """
        seen = compose(self.poses[candidates], self._centres[candidates])[:, :2]
        off = seen - compose(pose, self._centres[key])[:2]
        distance = np.hypot(off[:, 0], off[:, 1])
        turn = np.abs(wrap_angle(self.poses[candidates, 2] - pose[2]))
        order = np.argsort(distance + M_PER_RAD * turn, kind="stable")
        return np.asarray(order[distance[order] < reach_m])


def _doubled(rows: NDArray[Any]) -> NDArray[Any]:
    """The same rows with room for as many more."""
    return np.concatenate([rows, np.zeros_like(rows)])


_CONTRADICTION = 60.0  # squared Mahalanobis distance of a link that contradicts the graph, 3 degrees of freedom


class Closings:
    """The loop closures so far. A link to an old keyframe belongs to the last of them, which made its pose known."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._own: dict[int, list[int]] = {}
        """of each loop closure that stands: ids of the links that it was closed with"""
        self._latest: int | None = None
        self.accepted = 0
        """loop closures accepted so far"""
        self.undone = 0
        """loop closures taken back so far"""

    @property
    def links(self) -> list[KeyframeLink]:
        """Links to old keyframes."""
        return [link for link in self._graph.links.values() if link.kind is LinkKind.OLD]

    def own_keys(self) -> set[int]:
        """Keyframes of the links that loops were closed with."""
        return {key for own in self._own.values() for link in self._of(own) for key in (link.target, link.source)}

    def link(self, key: int) -> None:
        """Link a new keyframe to those before it, and to old ones around those that they are linked to."""
        self._graph.link(key, self._graph.recent(key), self._graph.near_linked(key), self._latest)

    def link_old(self, key: int, targets: Keys) -> None:
        """Link a keyframe to old ones near it."""
        if len(targets):
            self._graph.link(key, NO_KEYS, targets, self._latest)

    def close(self, links: list[tuple[Alignments, int]]) -> bool:
        """Close a loop with the links of a place, rows of alignments; whether it stays closed."""
        graph = self._graph
        self._latest = closure = self.accepted
        self.accepted += 1
        broken = self._broken(closure)
        given = graph.give(Alignments.of(links), np.ones(len(links), dtype=np.bool_), np.inf, closure)
        ids = graph.with_loss(given, LOSS)
        self._own[closure] = ids
        while contradicted := [g for g in self._own if self._contradiction(g) > _CONTRADICTION]:
            self._undo(max(contradicted, key=self._contradiction))
        if closure in self._own and self._broken(closure) - broken > len(links):
            self._undo(closure)
        return closure in self._own

    def _of(self, ids: list[int]) -> list[KeyframeLink]:
        return [self._graph.links[i] for i in ids]

    def _contradiction(self, g: int) -> float:
        """Median squared Mahalanobis distance from the estimate of the links that a loop was closed with."""
        own = self._own[g]
        return float(np.median(self._graph.squares(own))) if own else 0.0

    def _broken(self, newest: int) -> int:
        """How many links of all loop closures but the newest one contradict the estimate."""
        links = self._graph.links.items()
        others = [i for i, link in links if link.kind is LinkKind.OLD and link.closure != newest]
        return int(np.count_nonzero(self._graph.squares(others) > _CONTRADICTION))

    def _undo(self, g: int) -> None:
        """Take back a loop closure and all links that followed from it."""
        del self._own[g]
        self._graph.remove([i for i, link in self._graph.links.items() if link.closure == g])
        self.undone += 1
        if g == self._latest:
            self._latest = max(self._own, default=None)


_NEAR_M, _NEAR_RAD = 0.5, 0.35  # between poses from which a place looks the same
_ENOUGH = 8  # such keyframes
_LEAST_OLD_LINKS = 2  # of a keyframe whose place is known


class Thinning:
    """Which keyframes leave the graph."""

    def __init__(self, graph: ScanGraph, closings: Closings) -> None:
        self._graph, self._closings = graph, closings
        self._next = 1
        """the first keyframe that was not judged yet"""
        self._spare: list[int] = []
        """keyframes that will leave with the next ones"""

    def look(self, key: int) -> None:
        """Judge keyframes that are old enough at the newest one, `key`."""
        for k in range(self._next, key - OLD_AGE + 1):
            if self._is_spare(k) and k not in self._closings.own_keys():
                self._spare.append(k)
            self._next = k + 1
        if self._spare:
            # A loop may have been closed with some of them since they were judged.
            own_keys = self._closings.own_keys()
            self._spare = [k for k in self._spare if k not in own_keys]
        if len(self._spare) >= _PERIOD:
            self._graph.take_out(self._spare)
            self._spare = []

    def _is_spare(self, k: int) -> bool:
        """Whether a keyframe and those that are linked to it are known by old ones, of which there are enough."""
        graph = self._graph
        if any(len(graph.linked_old(j)) < _LEAST_OLD_LINKS for j in range(k, k + LINKS + 1)):
            return False
        kept = graph.is_kept[:k].copy()
        kept[self._spare] = False
        off = graph.poses[:k][kept] - graph.poses[k]
        near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR_M) & (np.abs(wrap_angle(off[:, 2])) < _NEAR_RAD)
        return bool(np.count_nonzero(near) >= _ENOUGH)
