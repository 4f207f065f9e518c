"""Data association: which observation is of which landmark, which is new, and which landmarks to forget.

It serves all estimators and calls only their `estimate` and `joint_covariance`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.chi_square import chi_square_quantile
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.association.agreement import predicted_cov
from sixthsense.slam.association.crookedness import Crookedness, Footprint, less_certain, noise_of_pairs
from sixthsense.slam.association.joint_compatibility import jointly_compatible
from sixthsense.slam.association.matching import (
    Indices,
    Innovations,
    assign,
    compare,
    compare_known,
    matches_nis,
    without_barely_covered,
)
from sixthsense.slam.association.pre_gate import pre_gate
from sixthsense.slam.association.records import Association, Record
from sixthsense.slam.association.rivals import best_agreed
from sixthsense.slam.association.wall_alignment import Alignment, align
from sixthsense.slam.association.wall_extents import collinear_pairs, disagreement, ends, fused, joined
from sixthsense.slam.estimators.base import Belief, Estimate, Estimator

_CONFIRMED = 3
"""matches that agree with each other, from which on a wall beside a known one can be another wall"""


Observer = Callable[[Sequence[Observation], Belief], None]
"""Called with all observations of a keyframe and the estimator before its update; must not change either."""


class Associator:
    """Gates and assigns observations, starts landmarks, culls those seen too rarely and merges duplicate walls."""

    def __init__(self, config: AssociationConfig, records: Mapping[LandmarkId, Record] | None = None) -> None:
        self._config = config
        self._next_id = 1 + max(records or [-1])
        self._scan = 0
        self.records: dict[LandmarkId, Record] = dict(records or {})
        """of every landmark in the state"""
        self.culled = 0
        """landmarks removed so far"""
        self.walls_merged = 0
        """walls merged into older duplicates, not counted as culled"""
        self._crookedness = Crookedness()
        self.observer: Observer | None = None
        """called before the observations of a keyframe are matched; for evaluation"""
        if config.method == "chi2":
            self._match_gate = float(chi_square_quantile(config.match_probability, 2))
            self._new_gate = float(chi_square_quantile(config.new_probability, 2))
        else:
            self._match_gate, self._new_gate = config.match_below, config.new_above
        self._gate_sigmas = math.sqrt(max(self._match_gate, self._new_gate))
        self._known_gate = float(chi_square_quantile(config.known_probability, 2))  # infinite for 1

    def associate(self, observations: Sequence[Observation], estimator: Belief) -> Association:
        """Match observations one-to-one with the landmarks by innovation; what is far from all is a new landmark."""
        self._scan += 1
        if self.observer is not None:
            self.observer(observations, estimator)
        estimate = estimator.estimate()
        if not observations:
            return Association({}, 0, 0.0, 0, 0, estimate.pose, estimate.pose_cov)
        for observation in observations:
            self._crookedness.add(observation.shape)
        records = [self.records[i] for i in estimate.ids.tolist()]
        sigmas = np.array([record.sigma_m for record in records])
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        aligned = Alignment(estimate.pose, 0.0)
        if self._config.align.enabled:
            aligned = align(observations, estimate, extents, self._config.wall_gap_m, self._config.align)
        fits = pre_gate(observations, estimate, aligned, sigmas, extents, self._gate_sigmas, self._config)
        near = np.flatnonzero(fits.plausible.any(axis=0))
        known: dict[LandmarkId, Observation] = {}
        nis, free, pieces, confirmed = 0.0, np.ones(len(observations), dtype=bool), 0, False
        if len(near):
            joint = estimator.joint_covariance(estimate.ids[near].tolist())
            for j, k in enumerate(near):
                records[k].sigma_m = math.sqrt(joint[3 + 2 * j, 3 + 2 * j] + joint[4 + 2 * j, 4 + 2 * j])
            squares = np.array([records[k].shape.square_m2(self._crookedness.excess) for k in near])
            noise = noise_of_pairs(observations, squares)
            innovation = compare(observations, estimate, near, joint, fits.plausible[:, near], noise)
            innovation = without_barely_covered(innovation, fits, near, self._match_gate)
            rows, cols, squared = self._assigned(innovation, joint)
            free = squared.min(axis=1) > self._new_gate
            free[rows] = False
            confirmed = len(rows) >= _CONFIRMED and self._config.assignment == "agreeing"
            matched = [observations[i] for i in rows.tolist()]
            for i in np.flatnonzero(~free).tolist():
                if i not in rows and observations[i].is_wall:
                    pieces += self._fuse(observations[i], squared[i, cols], matched)
            matched = [less_certain(observation, squares[j]) for j, observation in zip(cols, matched, strict=True)]
            known = {int(estimate.ids[near[j]]): observation for j, observation in zip(cols, matched, strict=True)}
            nis = matches_nis(innovation, matched, cols, joint)
        dof = 2 * len(known)
        for j, i in enumerate(estimate.ids.tolist()):
            if i in known:
                records[j].observations += 1
                records[j].last_scan = self._scan
                if known[i].is_wall:
                    seen = ends(estimate.pose, known[i])
                    records[j].shape.add(known[i].shape)
                    records[j].extent = joined(estimate.landmarks[j], extents[j], seen)
                    known[i] = records[j].seen_again(known[i], Footprint.of(estimate.pose, seen))
        is_wall = np.array([s.is_wall for s in observations])
        unmatched = np.flatnonzero(free & (fits.apart.all(axis=1) | (is_wall & confirmed))).tolist()
        new, more = self._start_landmarks(observations, unmatched, fits.sigmas, estimate)
        accepted, pieces = known | new, pieces + more
        discarded = len(observations) - len(accepted) - pieces
        return Association(accepted, discarded, nis, dof, pieces, estimate.pose, estimate.pose_cov)

    def known(self, observations: Mapping[LandmarkId, Observation], estimator: Estimator) -> Association:
        """Match observations that name their landmark, unless the name was misread; the NIS leaves out new ones."""
        self._scan += 1
        estimate = estimator.estimate()
        known = set(estimate.ids.tolist())
        old = [i for i in observations if i in known]
        misread: set[LandmarkId] = set()
        nis = 0.0
        if old:
            innovation, joint = compare_known(observations, old, estimate, estimator)
            kept = np.flatnonzero(np.diag(innovation.squared) <= self._known_gate)
            misread = set(old) - {old[k] for k in kept}
            nis = matches_nis(innovation, [observations[old[k]] for k in kept], kept, joint)
        accepted = {i: observation for i, observation in observations.items() if i not in misread}
        for i, observation in accepted.items():
            self.records.setdefault(i, Record(observation.kind, 0, self._scan, self._scan)).observations += 1
        dof = 2 * (len(old) - len(misread))
        return Association(accepted, len(misread), nis, dof, 0, estimate.pose, estimate.pose_cov)

    def nis(self, observations: Mapping[LandmarkId, Observation], estimator: Estimator) -> tuple[float, int]:
        """Normalised innovation squared of all observations, and its degrees of freedom; new landmarks left out."""
        estimate = estimator.estimate()
        known = set(estimate.ids.tolist())
        old = [i for i in observations if i in known]
        if not old:
            return 0.0, 0
        innovation, joint = compare_known(observations, old, estimate, estimator)
        return matches_nis(innovation, [observations[i] for i in old], np.arange(len(old)), joint), 2 * len(old)

    def cull(self) -> list[LandmarkId]:
        """Landmarks to forget now: seen too rarely a period after their first observation (report: bad landmarks)."""
        config = self._config
        if not config.culling or self._scan % config.cull_period:
            return []
        bad = [
            i
            for i, record in self.records.items()
            if record.observations < config.cull_below and self._scan - record.first_scan >= config.cull_period
        ]
        for i in bad:
            del self.records[i]
        self.culled += len(bad)
        return bad

    def merged(self, estimator: Estimator) -> list[LandmarkId]:
        """Walls to forget now, because they duplicate an older wall; checked once a period.

        Two walls are one when they lie in line, without a gap, and their difference passes the gate of a match. The
        younger wall's information about the poses stays in the estimate; that both are one is not added to it.
        """
        if self._scan % self._config.cull_period:
            return []
        estimate = estimator.estimate()
        kept = estimate.walls & np.isin(estimate.ids, list(self.records))  # some may just have been culled
        ids, walls = estimate.ids[kept].tolist(), estimate.landmarks[kept]
        records = [self.records[i] for i in ids]
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        recent = np.array([self._scan - record.last_scan < self._config.cull_period for record in records], dtype=bool)
        gone: list[LandmarkId] = []
        for j, k in collinear_pairs(walls, extents, recent, self._config.wall_gap_m, self._config.new_separation_m):
            if ids[j] in gone or ids[k] in gone:
                continue
            joint = estimator.joint_covariance([ids[j], ids[k]])[3:, 3:]
            cov = joint[:2, :2] + joint[2:, 2:] - joint[:2, 2:] - joint[2:, :2]
            if disagreement(walls[j], walls[k], cov) > self._match_gate:
                continue
            young, old = sorted((j, k), key=lambda n: (records[n].observations, -ids[n]))
            records[old].extent = joined(walls[old], records[old].extent, records[young].extent)
            records[old].observations += records[young].observations
            del self.records[ids[young]]
            gone.append(ids[young])
        self.walls_merged += len(gone)
        return gone

    def _assigned(self, innovation: Innovations, joint: Array) -> tuple[Indices, Indices, Array]:
        """Rows (observations) and columns (landmarks) of the matches, and squared innovations (m, k) of the others."""
        if self._config.assignment == "joint":
            probability = self._config.joint_probability
            return *jointly_compatible(innovation, joint, self._match_gate, probability), innovation.squared
        if self._config.assignment == "optimal":
            return *assign(innovation, self._match_gate), innovation.squared
        return best_agreed(innovation, predicted_cov(innovation, joint), self._match_gate)

    def _fuse(self, piece: Observation, squared: Array, matched: list[Observation]) -> bool:
        """Fuse another piece of a wall with the matched observation of it; whether the two agree, so that it was done.

        `squared` (n,) is the piece's squared innovation against the landmarks of `matched`.
        """
        if not len(squared) or squared.min() > self._match_gate:
            return False
        n = int(squared.argmin())
        if disagreement(piece.z, matched[n].z, piece.cov + matched[n].cov) > self._match_gate:
            return False
        matched[n] = fused(matched[n], piece)
        return True

    def _start_landmarks(
        self, observations: Sequence[Observation], unmatched: list[int], sigmas: Array, estimate: Estimate
    ) -> tuple[dict[LandmarkId, Observation], int]:
        """New landmarks of the observations at `unmatched`, and how many further observations were fused with these.

        `sigmas` (m,) metres, of all observations in the world.
        """
        new: dict[LandmarkId, Observation] = {}
        pieces = 0
        for k in unmatched:
            observation = observations[k]
            # One scan may show a wall's end from both sides, or a wall in two pieces: that is one landmark.
            twin = next((i for i, other in new.items() if self._are_one(observation, other)), None)
            if twin is not None:
                apart = (
                    disagreement(observation.z, new[twin].z, observation.cov + new[twin].cov)
                    if observation.is_wall
                    else 0.0
                )
                if observation.is_wall and apart <= self._match_gate:
                    new[twin] = fused(new[twin], observation)
                    pieces += 1
                    self.records[twin].extent = ends(estimate.pose, new[twin])
                # Of two walls of a scan that contradict each other both are taken: the returns of each are straight.
                if not observation.is_wall or apart <= self._match_gate or self._config.assignment != "agreeing":
                    continue
            record = Record(observation.kind, 1, self._scan, self._scan, float(sigmas[k]))
            if observation.is_wall:
                record.extent = ends(estimate.pose, observation)
                record.footprint = Footprint.of(estimate.pose, record.extent)
            record.shape.add(observation.shape)
            new[self._next_id], self.records[self._next_id] = observation, record
            self._next_id += 1
        squares = {i: self.records[i].shape.square_m2(self._crookedness.excess) for i in new}
        return {i: less_certain(observation, squares[i]) for i, observation in new.items()}, pieces

    def _are_one(self, one: Observation, other: Observation) -> bool:
        """Whether two observations of one scan are too close to be of two landmarks."""
        if one.is_wall != other.is_wall:
            return False
        if not one.is_wall:
            return math.dist(one.z, other.z) <= self._config.new_separation_m
        other_known = Estimate(Pose(), np.zeros((3, 3)), np.zeros(1, np.int64), other.z[None], np.ones(1, dtype=bool))
        extent = ends(Pose(), other)[None]
        here = Alignment(Pose(), 1.0)
        return not pre_gate([one], other_known, here, np.zeros(1), extent, self._gate_sigmas, self._config).apart[0, 0]
