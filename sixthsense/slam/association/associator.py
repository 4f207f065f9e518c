"""Data association: which sighting is of which landmark, which is new, and which landmarks to forget.

One piece of code for all estimators: it asks them for nothing but `estimate` and `joint_covariance`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Sighting, innovations
from sixthsense.slam.association.align import Alignment, align
from sixthsense.slam.association.candidates import Candidates
from sixthsense.slam.association.jcbb import jointly_compatible
from sixthsense.slam.association.matching import Indices, Innovations, assign, compare, joint_nis, pairs
from sixthsense.slam.association.walls import disagreement, ends, fused, in_line, joined
from sixthsense.slam.estimators.base import Estimate, Estimator


@dataclass(frozen=True, slots=True)
class Association:
    """What one key scan's sightings are of."""

    sightings: Mapping[LandmarkId, Sighting]
    """those the estimator shall take in; ids it does not know are new landmarks"""
    discarded: int
    """sightings too far for a match and too near for a new landmark, or of candidates"""
    nis: float
    """normalised innovation squared of all matches together, before the update"""
    dof: int
    """its degrees of freedom, 2 per match"""


@dataclass(slots=True)
class Record:
    """What is known of a landmark beside its two numbers."""

    kind: Kind
    """of its first sighting"""
    sightings: int
    """updates it has received, its birth included"""
    born_scan: int
    """key scan of its birth"""
    seen_scan: int
    """key scan of its last sighting"""
    sigma_m: float = math.inf
    """at most that of a point's position along any direction, when it was last looked at"""
    extent: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2) from where to where a wall was seen, world frame; not used of a point"""


class Associator:
    """Gates and assigns sightings, keeps candidates until they have proved themselves, and culls bad landmarks."""

    def __init__(self, config: AssociationConfig) -> None:
        self._config = config
        self._candidates = Candidates(config)
        self._next_id = 0
        self._scan = 0
        self.records: dict[LandmarkId, Record] = {}
        """of every landmark in the state"""
        self.culled = 0
        """landmarks removed so far"""
        self.walls_merged = 0
        """of them not counted: walls that have turned out to be others"""
        if config.method == "chi2":
            self._match_gate = float(chi2.ppf(config.match_probability, 2))
            self._new_gate = float(chi2.ppf(config.new_probability, 2))
        else:
            self._match_gate, self._new_gate = config.match_below, config.new_above
        self._sigmas = math.sqrt(max(self._match_gate, self._new_gate))
        self._known_gate = float(chi2.ppf(config.known_probability, 2))  # infinite for 1

    def associate(self, sightings: Sequence[Sighting], estimator: Estimator) -> Association:
        """Match sightings one-to-one with the landmarks by innovation; what fits none is a candidate or a landmark."""
        self._scan += 1
        self._candidates.next_scan()
        estimate = estimator.estimate()
        if not sightings:
            return Association({}, 0, 0.0, 0)
        records = [self.records[i] for i in estimate.ids.tolist()]
        sigmas = np.array([record.sigma_m for record in records])
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        aligned = Alignment(estimate.pose, 0.0)
        if self._config.align.enabled:
            aligned = align(sightings, estimate, extents, self._config.wall_gap_m, self._config.align)
        fits = pairs(sightings, estimate, aligned, sigmas, extents, self._sigmas, self._config)
        near = np.flatnonzero(fits.plausible.any(axis=0))
        known: dict[LandmarkId, Sighting] = {}
        nis, free, pieces = 0.0, np.ones(len(sightings), dtype=bool), 0
        if len(near):
            joint = estimator.joint_covariance(estimate.ids[near].tolist())
            for j, k in enumerate(near):
                records[k].sigma_m = math.sqrt(joint[3 + 2 * j, 3 + 2 * j] + joint[4 + 2 * j, 4 + 2 * j])
            innovation = compare(sightings, estimate, near, joint, fits.plausible[:, near])
            rows, cols = self._assigned(innovation, sightings, joint)
            free = innovation.squared.min(axis=1) > self._new_gate
            free[rows] = False
            matched = [sightings[i] for i in rows.tolist()]
            for i in np.flatnonzero(~free).tolist():
                if i not in rows and sightings[i].is_wall:
                    pieces += self._joins(sightings[i], innovation.squared[i, cols], matched)
            known = {int(estimate.ids[near[j]]): sighting for j, sighting in zip(cols, matched, strict=True)}
            nis = _matches_nis(innovation, matched, cols, joint)
        dof = 2 * len(known)
        for j, i in enumerate(estimate.ids.tolist()):
            if i in known:
                records[j].sightings += 1
                records[j].seen_scan = self._scan
                if known[i].is_wall:
                    records[j].extent = joined(estimate.landmarks[j], extents[j], ends(estimate.pose, known[i]))
        new, more = self._born(sightings, np.flatnonzero(free & fits.apart.all(axis=1)).tolist(), fits.sigmas, estimate)
        accepted, pieces = known | new, pieces + more
        return Association(accepted, len(sightings) - len(accepted) - pieces, nis, dof)

    def known(self, sightings: Mapping[LandmarkId, Sighting], estimator: Estimator) -> Association:
        """Take sightings whose landmarks are known by name, unless it was misread; the NIS is that of the old ones."""
        self._scan += 1
        estimate = estimator.estimate()
        order = {i: k for k, i in enumerate(estimate.ids.tolist())}
        old = [i for i in sightings if i in order]
        misread: set[LandmarkId] = set()
        nis = 0.0
        if old:
            near = np.array([order[i] for i in old])
            seen = [sightings[i] for i in old]
            joint = estimator.joint_covariance(old)
            innovation = compare(seen, estimate, near, joint, np.eye(len(old), dtype=bool))
            kept = np.flatnonzero(np.diag(innovation.squared) <= self._known_gate)
            misread = set(old) - {old[k] for k in kept}
            nis = _matches_nis(innovation, [seen[k] for k in kept], kept, joint)
        accepted = {i: sighting for i, sighting in sightings.items() if i not in misread}
        for i, sighting in accepted.items():
            self.records.setdefault(i, Record(sighting.kind, 0, self._scan, self._scan)).sightings += 1
        return Association(accepted, len(misread), nis, 2 * (len(old) - len(misread)))

    def cull(self) -> list[LandmarkId]:
        """Landmarks to forget now: seen too rarely, a period after their birth (report: bad landmark culling)."""
        config = self._config
        if not config.culling or self._scan % config.cull_period:
            return []
        bad = [
            i
            for i, record in self.records.items()
            if record.sightings < config.cull_below and self._scan - record.born_scan >= config.cull_period
        ]
        for i in bad:
            del self.records[i]
        self.culled += len(bad)
        return bad

    def merged(self, estimator: Estimator) -> list[LandmarkId]:
        """Walls to forget now, because they have turned out to be walls that are known longer; looked at once a period.

        Two walls are one when they lie in line, without a gap, and the joint covariance does not tell them apart. What
        the younger has told of the poses stays with them, but that both are one is not fed back.
        """
        if self._scan % self._config.cull_period:
            return []
        estimate = estimator.estimate()
        there = estimate.walls & np.isin(estimate.ids, list(self.records))  # some may just have been culled
        ids, walls = estimate.ids[there].tolist(), estimate.landmarks[there]
        records = [self.records[i] for i in ids]
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        recent = np.array([self._scan - record.seen_scan < self._config.cull_period for record in records], dtype=bool)
        gone: list[LandmarkId] = []
        for j, k in in_line(walls, extents, recent, self._config.wall_gap_m, self._config.new_separation_m):
            if ids[j] in gone or ids[k] in gone:
                continue
            joint = estimator.joint_covariance([ids[j], ids[k]])[3:, 3:]
            cov = joint[:2, :2] + joint[2:, 2:] - joint[:2, 2:] - joint[2:, :2]
            if disagreement(walls[j], walls[k], cov) > self._match_gate:
                continue
            young, old = sorted((j, k), key=lambda n: (records[n].sightings, -ids[n]))
            records[old].extent = joined(walls[old], records[old].extent, records[young].extent)
            records[old].sightings += records[young].sightings
            del self.records[ids[young]]
            gone.append(ids[young])
        self.walls_merged += len(gone)
        return gone

    def _assigned(
        self, innovation: Innovations, sightings: Sequence[Sighting], joint: Array
    ) -> tuple[Indices, Indices]:
        if self._config.assignment == "optimal":
            return assign(innovation, self._match_gate)
        noise = np.array([s.cov for s in sightings])
        return jointly_compatible(innovation, joint, noise, self._match_gate, self._config.joint_probability)

    def _joins(self, piece: Sighting, squared: Array, matched: list[Sighting]) -> bool:
        """Whether another piece of a wall was fused with the one that is matched: both must be one to the laser, too.

        `squared` (n,) is the piece's squared innovation against the landmarks of `matched`.
        """
        if not len(squared) or squared.min() > self._match_gate:
            return False
        n = int(squared.argmin())
        if disagreement(piece.z, matched[n].z, piece.cov + matched[n].cov) > self._match_gate:
            return False
        matched[n] = fused(matched[n], piece)
        return True

    def _born(
        self, sightings: Sequence[Sighting], free: list[int], sigmas: Array, estimate: Estimate
    ) -> tuple[dict[LandmarkId, Sighting], int]:
        """New landmarks of the sightings at `free`, which fit none, and how many more of these are pieces of them.

        `sigmas` (m,) metres, of all sightings in the world.
        """
        new: dict[LandmarkId, Sighting] = {}
        pieces = 0
        for k in free:
            sighting = sightings[k]
            # One scan may show a wall's end from both sides, or a wall in two pieces: one landmark, not two.
            twin = next((i for i, other in new.items() if self._same(sighting, other)), None)
            if twin is not None:
                apart = disagreement(sighting.z, new[twin].z, sighting.cov + new[twin].cov) if sighting.is_wall else 0.0
                if sighting.is_wall and apart <= self._match_gate:
                    new[twin] = fused(new[twin], sighting)
                    pieces += 1
                    self.records[twin].extent = ends(estimate.pose, new[twin])
                continue
            if not self._candidates.proves_itself(estimate.pose, sighting):
                continue
            extent = ends(estimate.pose, sighting) if sighting.is_wall else np.zeros((2, 2))
            new[self._next_id] = sighting
            self.records[self._next_id] = Record(sighting.kind, 1, self._scan, self._scan, float(sigmas[k]), extent)
            self._next_id += 1
        return new, pieces

    def _same(self, one: Sighting, other: Sighting) -> bool:
        """Whether two sightings of one scan are too near each other to be of two landmarks."""
        if one.is_wall != other.is_wall:
            return False
        if not one.is_wall:
            return math.dist(one.z, other.z) <= self._config.new_separation_m
        seen = Estimate(Pose(), np.zeros((3, 3)), np.zeros(1, np.int64), other.z[None], np.ones(1, dtype=bool))
        extent = ends(Pose(), other)[None]
        here = Alignment(Pose(), 1.0)
        return not pairs([one], seen, here, np.zeros(1), extent, self._sigmas, self._config).apart[0, 0]


def _matches_nis(innovation: Innovations, matched: Sequence[Sighting], cols: Indices, joint: Array) -> float:
    """Normalised innovation squared of all matches together, with the correlations between them."""
    index = np.concatenate([np.arange(3), (3 + 2 * cols[:, None] + np.arange(2)).ravel()])
    z = np.array([s.z for s in matched]).reshape(-1, 2)
    return joint_nis(
        joint[np.ix_(index, index)],
        innovation.by_pose[cols],
        innovation.by_landmark[cols],
        innovations(z, innovation.predicted[cols], innovation.walls[cols]),
        np.array([s.cov for s in matched]),
    )
