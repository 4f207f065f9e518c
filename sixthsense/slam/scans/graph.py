"""The graph of keyframes: their poses, and each link once, as the estimator was given it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from sixthsense.core.covariance import chi_square_quantile, root_information
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import between, compose, conjugate, move_covariance, triple
from sixthsense.slam.estimators import Link, Smoother
from sixthsense.slam.estimators.thinning import OLD_AGE, PERIOD
from sixthsense.slam.front_end import PoseLinks
from sixthsense.slam.scans.links import NEAR_GATE_M, Alignments, align_pairs, covariances
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import PRIOR_COUNT, Usual

Keys = NDArray[np.int64]
Rows = NDArray[Any]
"""a structured array, see `KEYFRAME` and `LINK`"""

LINKS = 4
"""links of a keyframe to those before it, and to old ones at most"""
REACH_M = 4.0
"""between the middles of what two scans see whose views overlap, and between poses from which they see much the same"""
M_PER_RAD = 0.5
"""a turn as a distance"""
LOSS = 4.0
"""scale of the Cauchy loss, in whitened error of three coordinates: 2.4 is usual for one (95 % efficiency)"""
_CORRELATION = 0.0625  # of two links of one scan, by the NEES of drives in rooms
_SQUARES = chi_square_quantile(np.arange(0.0005, 1.0, 0.001), 3)  # of right links, equally likely ones
_WEIGHTED = float(np.mean(_SQUARES / (1.0 + _SQUARES / LOSS**2)) / np.mean(_SQUARES))  # left of them by the loss
_LEAST_FACTOR = 0.5  # a beam meets a wall at any angle, and its noise across it has the squared cosine's mean, at least
_FACTOR_MOVES = 1.5  # ratio of the factor to the one before, beyond which all links are given again
_FACTOR_LINKS = 2000  # links, evenly among all, that the variance factor is estimated from

# `pose` is T_world_laser, `step` the variances of position and heading of the motion from the keyframe before, m^2 and
# rad^2, and `is_out` whether it has left the estimator's graph.
KEYFRAME = np.dtype([("pose", float, 3), ("step", float, 2), ("travelled_m", float), ("is_out", bool)])
# `id` is the estimator's, `ends` are target and source, `pose` is of the source's laser in the frame of the target's,
# `cov` of its error as the estimator was given it, axes of the target's laser, and `weight` what its squared residual
# counts beside one with the covariance by its returns alone. `is_old` is whether the target is of another pass,
# `closure` the number of the loop closure that it follows from, -1 for none, and `closes` whether it is one of the
# links that closed that loop.
LINK = np.dtype(
    [
        *(("id", np.int64), ("ends", np.int64, 2), ("pose", float, 3), ("cov", float, (3, 3)), ("weight", float)),
        *(("is_old", bool), ("closure", np.int64), ("closes", bool)),
    ]
)


class PlacedScans:
    """Scans with the poses of their lasers, in the order of a way."""

    def __init__(self, store: ScanStore) -> None:
        """Begin empty."""
        self.store = store
        """the scans, a row each"""
        self._keyframes = np.zeros(0, KEYFRAME)
        self.usual = Usual(0.0, 0.5)
        """what scans lately had where they were tracked"""

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return len(self._keyframes)

    @property
    def poses(self) -> Array:
        """(K, 3) `T_world_laser` of the keyframes; a view."""
        return np.asarray(self._keyframes["pose"])

    @property
    def travelled_m(self) -> Array:
        """(K,) way to each keyframe; a view."""
        return np.asarray(self._keyframes["travelled_m"])

    @property
    def usual_agreement(self) -> float:
        """Share of the returns, of those that are judged, that scans lately agreed in where they were tracked."""
        return 1.0 - self.usual.contradicted

    def add(self, pose: Array) -> None:
        """Add the newest keyframe at `pose` (3,), `T_world_laser`."""
        self._keyframes = _joined(self._keyframes, np.zeros(1, KEYFRAME))
        self._keyframes["pose"][-1] = pose

    def moved(self, travel_m: float, position_m2: float = 0.0, heading_rad2: float = 0.0) -> None:
        """Record the way to the newest keyframe, and the variances of position and heading of the motion to it."""
        before, row = self._keyframes[-2:]
        row["travelled_m"], row["step"] = before["travelled_m"] + travel_m, (position_m2, heading_rad2)


class ScanGraph(PlacedScans):
    """Keyframes with their poses as the estimator has them, and the links that it was given."""

    def __init__(self, store: ScanStore, estimator: Smoother, sigma_m: float) -> None:
        """Begin empty; `sigma_m` is the least sigma of a return."""
        super().__init__(store)
        self.estimator, self._sigma_m = estimator, sigma_m
        self.mount = np.zeros(3)
        """(3,) `T_robot_laser`"""
        self._rows: Rows = np.zeros(0, LINK)
        """the links, and rows without meaning behind them"""
        self.links = self._rows
        """those that the estimator has, rows of `LINK`; a view"""
        self._old = np.zeros((0, 2), np.int64)
        """(n, 2) ends of the links to old keyframes"""
        self.first = 0
        """index of the first keyframe since the robot was put where it is, or carried"""
        self._refreshed = 0
        """number of keyframes when all poses were read"""
        self.factor = 1.0
        """the variance factor: what the covariances that scans state are multiplied with in the graph"""

    @property
    def is_kept(self) -> NDArray[np.bool_]:
        """(K,) which keyframes are in the estimator's graph; the poses of others follow their neighbours'."""
        return ~self._keyframes["is_out"]

    def refresh(self) -> None:
        """Read all poses from the estimator."""
        self.poses[:] = compose(self.estimator.trajectory(), self.mount)
        self._refreshed = self.count

    def link(self, key: int, old: Keys, closure: int) -> None:
        """Link a new keyframe to old ones near it, and to those before it since the robot was last carried.

        Poses relative to it are known to some decimetres. All at once: each time costs the estimator a solution.
        """
        recent = np.arange(max(self.first, key - LINKS), key)
        targets, is_old = np.concatenate([recent, old]), np.arange(len(recent) + len(old)) >= len(recent)
        starts = between(self.poses[targets], self.poses[key]).reshape(-1, 3)
        found = align_pairs(self.store.returns, targets, np.full(len(targets), key), starts, NEAR_GATE_M)
        good = found.agree(self.usual_agreement)
        self.give(found.rows(good), is_old[good], closure)

    def give(self, found: Alignments, is_old: NDArray[np.bool_], closure: int, closes: bool = False) -> None:
        """Give aligned pairs to the estimator as links; those that close a loop without a loss.

        The n links of a scan share its returns. They count as n / (1 + (n - 1) r) independent ones, at most 1 / r, for
        a correlation r of two (a design effect; Kish, "Survey Sampling", 1965). Those that follow on others count as
        what is left, so that the sum is the same in whatever order they come.
        """
        if not len(is_old):
            return
        before = np.bincount(self.links["ends"][:, 1], minlength=self.count)[found.sources]
        after = before + np.bincount(found.sources)[found.sources]
        rows = np.zeros(len(is_old), LINK)
        rows["ends"] = np.column_stack([found.targets, found.sources])
        rows["pose"] = found.poses
        rows["weight"] = (_independent(after) - _independent(before)) / ((after - before) * self.factor)
        rows["cov"] = covariances(found.hessians, self._sigma_m) / rows["weight"][:, None, None]
        rows["is_old"], rows["closure"], rows["closes"] = is_old, np.where(is_old, closure, -1), closes
        self._give(rows)
        self._append(rows)
        if closes or self.count - self._refreshed >= PERIOD:
            self.refresh()
            if not closes:
                self._weigh()
            return
        # The newest poses have moved, and those that links lead to.
        keys = sorted({*range(max(0, self.count - LINKS - 1), self.count), *found.targets[is_old].tolist()})
        self.poses[keys] = compose(self.estimator.poses_at(keys), self.mount)

    def _give(self, rows: Rows) -> None:
        losses = np.where(rows["closes"], np.inf, LOSS / math.sqrt(min(1.0, self.factor)))
        given = self.robot_links(rows)
        measured = zip(given.ends.tolist(), given.motions.tolist(), given.covs, losses.tolist(), strict=True)
        links = [Link(a, b, Odometry(Pose(*motion), cov), loss) for (a, b), motion, cov, loss in measured]
        rows["id"] = self.estimator.link(links)

    def _weigh(self) -> None:
        """Give all links again if the variance factor has moved: those of the beginning would count more or less."""
        factor = self._fitted_factor()
        ratio = factor / self.factor
        if max(ratio, 1.0 / ratio) > _FACTOR_MOVES:
            self.factor, links = factor, self.links.copy()
            links["cov"] *= ratio
            links["weight"] /= ratio
            self._give(links)  # before the old ones are taken back: the graph stays bound
            self.estimator.unlink(self.links["id"].tolist())
            self.links = self._rows = links
            self.refresh()

    def remove(self, which: NDArray[np.bool_]) -> None:
        """Take some of the links back."""
        self.estimator.unlink(self.links["id"][which].tolist())
        self._keep(~which)
        self.refresh()

    def take_out(self, keys: list[int]) -> None:
        """Take keyframes out of the estimator's graph, with their links."""
        lost = self.estimator.take_out(keys)
        self._keyframes["is_out"][keys] = True
        self._keep(~np.isin(self.links["id"], lost))
        self.refresh()

    def _append(self, links: Rows) -> None:
        count, self._old = len(self.links) + len(links), np.concatenate([self._old, links["ends"][links["is_old"]]])
        if count > len(self._rows):
            self._rows = _joined(self.links, np.zeros(count, LINK))
        self._rows[len(self.links) : count] = links
        self.links = self._rows[:count]

    def _keep(self, which: NDArray[np.bool_]) -> None:
        self.links = self._rows = self.links[which]
        self._old = np.ascontiguousarray(self.links["ends"][self.links["is_old"]])

    def robot_links(self, links: Rows) -> PoseLinks:
        """Links, between poses of the robot."""
        mount, poses = triple(self.mount), links["pose"]
        motions = [conjugate(mount, triple(pose)) for pose in poses]
        # The covariance of a link is in the axes of its target.
        covs = [
            move_covariance(compose(mount, (0.0, 0.0, -float(pose[2]))), cov)
            for pose, cov in zip(poses, links["cov"], strict=True)
        ]
        ends = np.ascontiguousarray(links["ends"])
        return PoseLinks(ends, np.array(motions).reshape(-1, 3), np.array(covs).reshape(-1, 3, 3))

    def _fitted_factor(self) -> float:
        """The a posteriori variance of unit weight of the links, as of a least-squares adjustment.

        It is the sum of the squares of their residuals, whitened by the covariance that their returns alone give, over
        the redundancy: the coordinates of the links less those of the poses that they bind. The factor is 1 where the
        robot was carried: the covariance of a motion that nothing has measured is as stated.
        """
        if self.first or not len(self.links):
            return 1.0
        links = self.links[:: 1 + len(self.links) // _FACTOR_LINKS]
        squares = self.squares(links) / links["weight"]
        redundancy = 3.0 * len(links) * (1.0 - len(np.unique(self.links["ends"][:, 1])) / len(self.links))
        factor = self.factor
        for _ in range(5):
            # Weighted by the loss: a few wrong links are no evidence of the others. Of right ones so much is left.
            weighted = squares / (_WEIGHTED * (1.0 + squares / (LOSS**2 * factor)))
            factor = float((weighted.sum() + PRIOR_COUNT) / (redundancy + PRIOR_COUNT))
        return max(_LEAST_FACTOR, factor)

    def squares(self, links: Rows) -> Array:
        """(n,) squared Mahalanobis distances of links from the estimate."""
        before, after = (np.ascontiguousarray(self.poses[end]) for end in links["ends"].T)
        off = links["pose"] - between(before, after).reshape(-1, 3)
        off[:, 2] = wrap_angle(off[:, 2])
        return np.asarray(((root_information(links["cov"]) @ off[:, :, None]) ** 2).sum(axis=(1, 2)))

    def linked_old(self, first: int, last: int) -> Keys:
        """Old keyframes that those from `first` to `last` are linked to."""
        ends = self._old
        return np.asarray(ends[(ends[:, 1] >= first) & (ends[:, 1] <= last), 0])

    def old_links(self) -> NDArray[np.int64]:
        """(K,) number of links of each keyframe to old ones."""
        return np.bincount(self._old[:, 1], minlength=self.count)

    def near_linked(self, key: int) -> Keys:
        """Old keyframes around those that the last keyframes are linked to, the nearest first."""
        reach = 2 * LINKS
        old = self.linked_old(key - reach, key - 1)
        around = old[:, None] + np.arange(-reach, reach + 1)
        return self.nearest(key, np.intersect1d(around, self.old(key)))

    def old(self, key: int) -> Keys:
        """Keyframes in the graph that are not of the pass of keyframe `key`: old ones, or from before a carry."""
        return np.flatnonzero(self.is_kept[: max(self.first, key - OLD_AGE, 0)])

    def nearest(self, key: int, candidates: Keys) -> Keys:
        """The candidates, at most `LINKS`, with the poses nearest to that of a keyframe, within reach.

        Links to poses of one pass, side by side, cost the solver a third less than links to those whose views overlap
        most, which are of several passes.
        """
        return _nearest(self.poses[key], self.poses[candidates], candidates)[:LINKS]

    def sigmas(self, key: int) -> tuple[Array, Array]:
        """(K,) sigmas of position, m, and heading, rad, of keyframe `key` relative to each, along the best ways there.

        The ways follow motions from keyframe to keyframe and links to old ones. An error of heading moves the position
        by its distance from `key`, so that variances add up along a way (Dijkstra).
        """
        # Where to look for a place is asked of what the returns state: links may be to a wrong one that looks alike.
        covs, steps = self.links["cov"][self.links["is_old"]] / min(1.0, self.factor), np.arange(1, self.count)
        ends = np.concatenate([np.column_stack([steps - 1, steps]), self._old])
        xx, yy, xy = covs[:, 0, 0], covs[:, 1, 1], covs[:, 0, 1]
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        variances = np.vstack([self._keyframes["step"][1 : self.count], np.column_stack([largest, covs[:, 2, 2]])])
        lever = self.poses[ends[:, 1], :2] - self.poses[key, :2]
        costs = variances[:, 0] + variances[:, 1] * (lever**2).sum(axis=1), variances[:, 1]
        # Rows by hand: a conversion would add up the variances of several edges between two keyframes. Indices have 32
        # bits, which SciPy's search asks for.
        order, ends = np.argsort(ends[:, 0]), ends.astype(np.int32)
        first = np.searchsorted(ends[order, 0], np.arange(self.count + 1)).astype(np.int32)
        graphs = (csr_array((cost[order], ends[order, 1], first), (self.count, self.count)) for cost in costs)
        position, heading = (np.sqrt(dijkstra(graph, directed=False, indices=[key])[0]) for graph in graphs)
        return position, heading


def overlapping(scans: PlacedScans, key: int, pose: Array, candidates: NDArray[np.int64]) -> NDArray[np.int64]:
    """Candidates whose views overlap that of scan `key` if it is at `pose` (3,), the most first.

    What counts is the distance between the centres of what the scans see: a laser that looks forward sees from either
    end of a corridor what is between. The pose and those of the scans are of one frame.
    """
    poses, centres = scans.poses[candidates], scans.store.centres
    return _nearest(compose(pose, centres[key]), compose(poses, centres[candidates]).reshape(-1, 3), candidates)


def _nearest(pose: Array, poses: Array, candidates: Keys) -> Keys:
    """Candidates with `poses` (m, 3) within reach of a pose (3,), the nearest first."""
    distance, turn = np.hypot(*(poses - pose)[:, :2].T), np.abs(wrap_angle(poses[:, 2] - pose[2]))
    order = np.argsort(distance + M_PER_RAD * turn, kind="stable")
    return np.asarray(candidates[order[distance[order] < REACH_M]], dtype=np.int64)


def _joined(rows: Rows, more: Rows) -> Rows:
    """Rows and those that follow them, joined as bytes: NumPy copies structured rows field by field."""
    return np.concatenate([rows.view(np.uint8), more.view(np.uint8)]).view(rows.dtype)


def _independent(links: Keys) -> Array:
    """(n,) how many independent links so many of one scan count as."""
    return np.asarray(links / (1.0 + (links - 1.0) * _CORRELATION))
