"""The graph of keyframes: their poses, and the links between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Link, PoseGraphEstimator, takes_out_poses
from sixthsense.slam.scans.alignment import SUMS
from sixthsense.slam.scans.links import NEAR_GATE_M, TRACKED_GATE_M, Alignments, align_pairs, covariances
from sixthsense.slam.scans.mount import Mount
from sixthsense.slam.scans.poses import between, compose
from sixthsense.slam.scans.scan_store import ScanStore

RECENT = 4  # keyframes before a keyframe that it is linked to
_OLD = 4  # most links of a keyframe to old ones
_OLD_AGE = 20  # keyframes; nearer ones are of the same pass
_LINKED_LATELY = 6  # keyframes back from the newest whose old partners' neighbours are linked
_ALONG = 8  # keyframes to either side of an old partner
_REACH_M, _REACH_RAD = 3.0, 2.0  # between the poses of linked scans: the views must overlap
_M_PER_RAD = 1.0  # what a turn counts against a distance when the nearest are selected
_RECENT_AGREEMENT, OLD_AGREEMENT = 0.6, 0.8  # least share of hits among hits and views through
_MAX_SHIFT_M = 0.5  # between an alignment's begin and its end
_NEWEST, _REFRESH_PERIOD = 8, 10  # keyframes whose poses are read each time, and between two times that all are
_JUMP_M = 0.01  # a pose that moves farther says that others have moved, too
_RECENT_LOSS, OLD_LOSS = 5.0, 3.0  # scales of the Cauchy loss, in whitened error


class OldLinks(NamedTuple):
    """Links between scans of different passes."""

    ids: list[int]
    """of the estimator's links"""
    rows: list[tuple[Alignments, int]]
    """of the alignments that they are"""


class ScanGraph:
    """Keyframes with their poses as the estimator has them, and the links that it was given."""

    def __init__(self, store: ScanStore, estimator: PoseGraphEstimator, sigma_m: float) -> None:
        """Begin empty; `sigma_m` is the least sigma of a return."""
        self.store, self.estimator = store, estimator
        self._sigma_m = sigma_m
        self._rows = np.zeros((64, 3))
        self._centres = np.zeros((64, 3))
        """middle of what each keyframe sees, in its frame, as poses without a turn"""
        self.mount = Mount(Pose())
        self.old_links: dict[int, list[int]] = {}
        """of a keyframe: the older ones of another pass that it is linked to"""
        self._links = np.zeros(64, dtype=np.int64)
        """links of each keyframe to earlier ones"""
        self._is_kept = np.ones(64, dtype=np.bool_)
        self.count = 0
        self.first = 0
        """index of the first keyframe since the robot was put where it is, or carried"""
        self._refreshed = 0
        """number of keyframes when all poses were read"""
        self._waiting: list[tuple[Alignments, int]] = []
        """links to recent keyframes, given together with those to old ones: each time costs the estimator a solution"""

    @property
    def poses(self) -> Array:
        """(K, 3) `T_world_laser` of the keyframes; a view."""
        return self._rows[: self.count]

    @property
    def is_kept(self) -> NDArray[np.bool_]:
        """(K,) which keyframes are in the estimator's graph; a view. The poses of others follow their neighbours'."""
        return self._is_kept[: self.count]

    def add(self, pose: Array, mount: Mount) -> None:
        """Add the newest keyframe at `pose` (3,), `T_world_laser`."""
        if self.count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            self._links = np.concatenate([self._links, np.zeros_like(self._links)])
            self._is_kept = np.concatenate([self._is_kept, np.ones_like(self._is_kept)])
            self._centres = np.concatenate([self._centres, np.zeros_like(self._centres)])
        self._rows[self.count], self.mount = pose, mount
        points = self.store.returns.points[self.count]
        self._centres[self.count, :2] = points[:, :2].sum(axis=0) / max(np.count_nonzero(points[:, 2]), 1)
        self.count += 1

    def refresh(self) -> None:
        """Take all poses from the estimator."""
        self._rows[: self.count] = self.mount.laser_poses(self.estimator.trajectory())
        self._refreshed = self.count

    def _refresh_near(self, rows: list[tuple[Alignments, int]]) -> None:
        """Take the newest poses and those that links lead to; all of them from time to time, and after a jump."""
        newest = range(max(0, self.count - _NEWEST), self.count)
        keys = sorted({*newest, *(int(found.targets[k]) for found, k in rows)})
        poses = self.mount.laser_poses(self.estimator.poses_at(keys))
        shift = np.hypot(*(poses[:, :2] - self._rows[keys, :2]).T)
        self._rows[keys] = poses
        if self.count - self._refreshed >= _REFRESH_PERIOD or shift.max() > _JUMP_M:
            self.refresh()

    def link(self, key: int, old: NDArray[np.int64]) -> OldLinks:
        """Link a new keyframe to those just before it, and to old ones near it; the links to old ones."""
        recent = self._align(np.arange(max(self.first, key - RECENT), key), key, TRACKED_GATE_M)
        good = np.flatnonzero(recent.agree(self.store.returns, _RECENT_AGREEMENT))
        self._waiting = [(recent, int(k)) for k in good]
        return self.link_old(key, old)

    def link_old(self, key: int, targets: NDArray[np.int64]) -> OldLinks:
        """Link a keyframe to old ones near it, whose poses relative to it are known to some decimetres."""
        found = self._align(targets, key, NEAR_GATE_M)
        shift = found.poses[:, :2] - between(self.poses[targets], self.poses[key])[:, :2]
        near = np.hypot(shift[:, 0], shift[:, 1]) < _MAX_SHIFT_M
        good = np.flatnonzero(found.agree(self.store.returns, OLD_AGREEMENT) & near)
        rows = [(found, int(k)) for k in good]
        return OldLinks(self.give(rows, OLD_LOSS), rows)

    def _align(self, targets: NDArray[np.int64], key: int, gate_m: float) -> Alignments:
        """Align a keyframe with others, from the present poses."""
        starts = between(self.poses[targets], self.poses[key])
        return align_pairs(self.store.returns, targets, np.full(len(targets), key), starts, gate_m)

    def give(self, rows: list[tuple[Alignments, int]], loss_scale: float) -> list[int]:
        """Give the estimator links between scans of different passes, rows of alignments; their ids."""
        for found, k in rows:
            self.old_links.setdefault(int(found.sources[k]), []).append(int(found.targets[k]))
        recent, self._waiting = self._waiting, []
        for found, k in (*recent, *rows):
            self._links[found.sources[k]] += 1
        given = [*recent, *rows]
        losses = [_RECENT_LOSS] * len(recent) + [loss_scale] * len(rows)
        covs = self.covariances(given)
        links = [self._link(found, k, cov, loss) for (found, k), cov, loss in zip(given, covs, losses, strict=True)]
        ids = self.estimator.link(links)[len(recent) :]
        if links:
            self._refresh_near(rows)
        return ids

    def take_out(self, keys: list[int]) -> None:
        """Take keyframes out of the estimator's graph: nothing is linked to them any more."""
        assert takes_out_poses(self.estimator)
        self.estimator.take_out(keys)
        self._is_kept[keys] = False
        self.refresh()

    def forget(self, pairs: list[tuple[int, int]]) -> None:
        """Forget that these pairs (target, source) are linked."""
        for target, source in pairs:
            self._links[source] -= 1
            self.old_links[source].remove(target)
            if not self.old_links[source]:
                del self.old_links[source]

    def near_linked(self, key: int) -> NDArray[np.int64]:
        """Old keyframes around those that the last keyframes are linked to, the nearest first."""
        return self._around(key, range(max(0, key - _LINKED_LATELY), key))

    def near_linked_later(self, key: int) -> NDArray[np.int64]:
        """Old keyframes around those that the next keyframes are linked to, the nearest first."""
        return self._around(key, range(key + 1, min(key + 1 + _LINKED_LATELY, self.count)))

    def _around(self, key: int, linked: range) -> NDArray[np.int64]:
        around: set[int] = set()
        for other in linked:
            for old in self.old_links.get(other, ()):
                around.update(range(max(0, old - _ALONG), min(old + _ALONG + 1, key - _OLD_AGE)))
        candidates = np.array(sorted(around), dtype=np.int64)
        return self.nearest(key, candidates[self.is_kept[candidates]])

    def nearest(self, key: int, candidates: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of the candidates whose views overlap that of a keyframe most, by their poses."""
        off = between(self.poses[key], self.poses[candidates])
        distance, turn = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
        near = np.flatnonzero((distance < _REACH_M) & (turn < _REACH_RAD))
        order = np.argsort(distance[near] + _M_PER_RAD * turn[near], kind="stable")
        return candidates[near[order][:_OLD]]

    def overlapping(self, key: int, pose: Array, candidates: NDArray[np.int64], reach_m: float) -> NDArray[np.int64]:
        """Rows of `candidates` whose views overlap that of keyframe `key` if it is at `pose` (3,), the most first.

        What counts is the distance between the centres of what the scans see: a laser that looks forward sees from
        either end of a corridor what is between. The pose and those in `poses` are of one frame.
        """
        seen = compose(self.poses[candidates], self._centres[candidates])[:, :2]
        off = seen - compose(pose, self._centres[key])[:2]
        distance = np.hypot(off[:, 0], off[:, 1])
        turn = np.abs(wrap_angle(self.poses[candidates, 2] - pose[2]))
        order = np.argsort(distance + _M_PER_RAD * turn, kind="stable")
        return np.asarray(order[distance[order] < reach_m])

    def linked_old(self, key: int) -> NDArray[np.int64]:
        """Old keyframes that a keyframe is linked to."""
        return np.array(self.old_links.get(key, ())[:_OLD], dtype=np.int64)

    def covariances(self, rows: list[tuple[Alignments, int]]) -> Array:
        """(m, 3, 3) of the errors of aligned pairs, rows of alignments, axes of the targets' lasers."""
        # The links of a scan are together worth its alignment with a map of that many scans: each return counts once.
        sums = np.array([found.sums[k] for found, k in rows]).reshape(-1, SUMS)
        sources = np.array([found.sources[k] for found, k in rows], dtype=np.int64)
        return covariances(sums, 1.0 + self._links[sources].astype(np.float64), self._sigma_m)

    def _link(self, found: Alignments, k: int, cov: Array, loss_scale: float) -> Link:
        """The link of an aligned pair, in the robot's frames."""
        of_laser = Odometry(Pose.from_array(found.poses[k]), cov)
        return Link(int(found.targets[k]), int(found.sources[k]), self.mount.robot_odometry(of_laser), loss_scale)
