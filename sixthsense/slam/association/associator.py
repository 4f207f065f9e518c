"""Data association: which observation is of which landmark, which is new, and which landmarks to forget.

It serves all estimators and calls only their `estimate` and `joint_covariance`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.covariance import SIGNIFICANT, difference_covariance
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.association.matching import Matches, Usual, compare_known, match
from sixthsense.slam.association.named import Contradictions
from sixthsense.slam.association.observed import (
    Distances,
    Mask,
    Observed,
    collinear_pairs,
    disagreement,
    ends,
    fused,
    joined,
)
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Association, Crookedness, Record, less_certain
from sixthsense.slam.association.slip import matches_after_slip
from sixthsense.slam.association.unknown import UnknownPoints
from sixthsense.slam.estimators.base import Belief, Estimate, Estimator

AreFree = Callable[[Array, float], Mask]
"""(N,) whether a map shows nothing but free cells around the points (N, 2), world frame, within a distance, m"""

CULL_PERIOD = 25
"""keyframes between two looks for landmarks to forget: the robot has turned around or left the room"""
_PARTS = 10
"""of a wall's extent, at whose limits the map is asked"""


def nowhere_free(points: Array, within_m: float) -> Mask:
    """Default: no point is known to be free."""
    return np.zeros(len(points), dtype=bool)


class Associator:
    """Gates and assigns observations, starts landmarks, and forgets those that are rare, double or no longer there."""

    def __init__(
        self,
        config: AssociationConfig,
        records: Mapping[LandmarkId, Record] | None = None,
        are_free: AreFree = nowhere_free,
    ) -> None:
        """Begin with the `records` of a prior map, whose landmarks are gone where this run's map says `are_free`."""
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
        self._unknown = UnknownPoints()
        self._prior, self._are_free = frozenset(self.records), are_free
        self._contradictions = Contradictions(config.known_probability)

    def associate(
        self,
        observations: Sequence[Observation],
        estimator: Belief,
        proposed: ProposedLandmarks | None = None,
    ) -> Association:
        """Match observations with landmarks, all at once; what is far from all landmarks is a new one.

        The landmarks lie where the estimator has them, or as `proposed`; the NIS is that of the estimator.
        """
        self._scan += 1
        estimate = estimator.estimate()
        if not observations:
            return Association()
        for observation in observations:
            self._crookedness.add(observation.shape)
        observed = Observed.of(observations)
        is_point = ~observed.walls
        points = observed.z[is_point]
        usual = Usual(self._crookedness.excess, self._unknown.density(points))
        extents = self._extents(estimate) if proposed is None else proposed.extents

        def at(belief: Belief, estimate: Estimate) -> Matches:
            return match(observed, belief, estimate, extents, self.records, usual, self._config)

        slip = None
        if proposed is None:
            matches, slip = matches_after_slip(at, estimator, estimate, self._config.new_gate)
        else:
            matches = at(proposed, proposed.estimate())
        self._unknown.add(points, matches.landmark[is_point] < 0)
        if slip is not None:  # extents are where the robot is
            estimate = replace(estimate, pose=matches.pose)
        known, pieces = self._seen_again(observations, matches, estimate)
        nis = matches.nis(known) if proposed is None else self.nis(known, estimator)[0]
        new, more = self._start_landmarks(observations, observed, np.flatnonzero(matches.is_new).tolist(), estimate)
        accepted, pieces, dof = known | new, pieces + more, 2 * len(known)
        discarded = len(observations) - len(accepted) - pieces
        return Association(accepted, discarded, nis, dof, pieces, slip)

    def _seen_again(
        self, observations: Sequence[Observation], matches: Matches, estimate: Estimate
    ) -> tuple[dict[LandmarkId, Observation], int]:
        """The observations of known landmarks, and how many further ones were fused with these."""
        known: dict[LandmarkId, Observation] = {}
        for observation, i in zip(observations, matches.landmark.tolist(), strict=True):
            if i >= 0:
                known[i] = fused(known[i], observation) if i in known else observation
        pieces = int(np.count_nonzero(matches.landmark >= 0)) - len(known)
        rows = {i: k for k, i in enumerate(estimate.ids.tolist())}
        for i, observation in known.items():
            record = self.records[i]
            record.observations += 1
            record.last_scan = self._scan
            if observation.is_wall:
                known[i] = less_certain(observation, record.shape.square_m2(self._crookedness.excess))
                record.seen_again(observation, estimate.pose, estimate.landmarks[rows[i]])
        return known, pieces

    def match_named(self, observations: Mapping[LandmarkId, Observation], estimator: Estimator) -> Association:
        """Match observations that name their landmark, unless the name was misread; the NIS leaves out new ones.

        Where different landmarks contradict the estimate, and agree with each other, the robot has slipped.
        """
        self._scan += 1
        estimate = estimator.estimate()
        known = set(estimate.ids.tolist())
        old = [i for i in observations if i in known]
        misread: set[LandmarkId] = set()
        nis, slip = 0.0, None
        if old:
            innovation = compare_known(observations, old, estimate, estimator)
            gates = [self._contradictions.gate(self.records[i]) for i in old]
            kept = np.flatnonzero(np.diag(innovation.squared) <= gates)
            misread = set(old) - {old[k] for k in kept}
            nis = innovation.nis([observations[old[k]] for k in kept], kept)
            self._contradictions.add({i: observations[i] for i in misread}, estimate, self.records)
            if len(kept):
                self._contradictions.agreed()
            elif found := self._contradictions.slip(estimate, estimator):
                self._contradictions.explained()
                slip, misread = found[0], misread - set(found[1])
        accepted = {i: observation for i, observation in observations.items() if i not in misread}
        if self._contradictions.is_robot_doubtful:  # what is new would be put into a wrong place
            accepted = {i: accepted[i] for i in accepted if i in known}
        for i, observation in accepted.items():
            record = self.records.setdefault(i, Record(observation.kind, 0, self._scan, self._scan))
            record.observations += 1
            record.last_scan = self._scan
        dof = 2 * (len(old) - len(misread)) if slip is None else 0
        return Association(accepted, len(observations) - len(accepted), nis, dof, slip=slip)

    def nis(self, observations: Mapping[LandmarkId, Observation], estimator: Belief) -> tuple[float, int]:
        """Normalised innovation squared of all observations, and its degrees of freedom; new landmarks left out."""
        estimate = estimator.estimate()
        known = set(estimate.ids.tolist())
        old = [i for i in observations if i in known]
        if not old:
            return 0.0, 0
        innovation = compare_known(observations, old, estimate, estimator)
        return innovation.nis([observations[i] for i in old], np.arange(len(old))), 2 * len(old)

    def forgotten(self, estimator: Estimator, estimate: Estimate) -> list[LandmarkId]:
        """Landmarks to forget after an update, whose estimate is given; looked for once a period.

        They were seen too rarely, duplicate an older wall, or are of a prior map and no longer there.
        """
        disproved = self._contradictions.disproved(self.records)
        for i in disproved:
            del self.records[i]
        self.culled += len(disproved)
        if self._scan % CULL_PERIOD:
            return disproved
        culled = self._culled()
        merged = self._merged(estimator, estimate)
        return [*disproved, *culled, *merged, *self._vanished(estimate)]

    def _vanished(self, estimate: Estimate) -> list[LandmarkId]:
        """Landmarks of a prior map that were not seen for a period, where the map shows the most of them free."""
        within_m = SIGNIFICANT * math.sqrt(estimate.pose_cov[0, 0] + estimate.pose_cov[1, 1])
        gone: list[LandmarkId] = []
        for i, landmark, is_wall in zip(estimate.ids.tolist(), estimate.landmarks, estimate.walls, strict=True):
            record = self.records.get(i) if i in self._prior else None
            if record is None or self._scan - record.last_scan < CULL_PERIOD:
                continue
            places = np.linspace(record.extent[0], record.extent[1], _PARTS + 1) if is_wall else landmark[None]
            if np.mean(self._are_free(places, within_m)) > 0.5:
                del self.records[i]
                gone.append(i)
        self.culled += len(gone)
        return gone

    def _culled(self) -> list[LandmarkId]:
        """Landmarks that were seen too rarely a period after their first observation (report: bad landmarks)."""
        config = self._config
        bad = [
            i
            for i, record in self.records.items()
            if record.observations < config.cull_below and self._scan - record.first_scan >= CULL_PERIOD
        ]
        for i in bad:
            del self.records[i]
        self.culled += len(bad)
        return bad

    def _merged(self, estimator: Estimator, estimate: Estimate) -> list[LandmarkId]:
        """Walls that duplicate an older wall.

        Two walls are one when they lie in line, without a gap, and their difference passes the gate of a match. The
        younger wall's information about the poses stays in the estimate; that both are one is not added to it.
        """
        kept = estimate.walls & np.isin(estimate.ids, list(self.records))  # some may just have been culled
        ids, walls = estimate.ids[kept].tolist(), estimate.landmarks[kept]
        records = [self.records[i] for i in ids]
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        recent = np.array([self._scan - record.last_scan < CULL_PERIOD for record in records], dtype=bool)
        gone: list[LandmarkId] = []
        for j, k in collinear_pairs(walls, extents, recent, self._config.new_separation_m):
            if ids[j] in gone or ids[k] in gone:
                continue
            joint = estimator.joint_covariance([ids[j], ids[k]])[3:, 3:]
            if disagreement(walls[j], walls[k], difference_covariance(joint, 0, 1)) > self._config.match_gate:
                continue
            young, old = sorted((j, k), key=lambda n: (records[n].observations, -ids[n]))
            records[old].extent = joined(walls[old], records[old].extent, records[young].extent)
            records[old].observations += records[young].observations
            del self.records[ids[young]]
            gone.append(ids[young])
        self.walls_merged += len(gone)
        return gone

    def _extents(self, estimate: Estimate) -> Array:
        """(n, 2, 2) ends of the landmarks that are walls, world frame."""
        return np.array([self.records[i].extent for i in estimate.ids.tolist()]).reshape(-1, 2, 2)

    def _start_landmarks(
        self, observations: Sequence[Observation], observed: Observed, unmatched: list[int], estimate: Estimate
    ) -> tuple[dict[LandmarkId, Observation], int]:
        """New landmarks of the observations at `unmatched`, and how many further observations were fused with these.

        `observed` are the arrays of all observations.
        """
        new: dict[LandmarkId, Observation] = {}
        pieces = 0
        if not unmatched:
            return new, pieces
        sigmas = observed.sigmas_m(estimate.pose_cov)
        for k in unmatched:
            observation = observations[k]
            # One scan may show a wall's end from both sides, or a wall in two pieces: that is one landmark. Of two
            # walls of a scan that contradict each other both are taken: the returns of each are straight.
            twin = next((i for i, other in new.items() if self._are_one(observation, other)), None)
            if twin is None:
                record = Record(observation.kind, 1, self._scan, self._scan, float(sigmas[k]))
                new[self._next_id], self.records[self._next_id] = observation, record
                self._next_id += 1
            elif observation.is_wall:
                new[twin] = fused(new[twin], observation)
                pieces += 1
        for i, observation in new.items():
            record = self.records[i]
            record.shape.add(observation.shape)
            if observation.is_wall:
                record.extent = ends(estimate.pose, observation)
        excess = self._crookedness.excess
        return {i: less_certain(seen, self.records[i].shape.square_m2(excess)) for i, seen in new.items()}, pieces

    def _are_one(self, one: Observation, other: Observation) -> bool:
        """Whether two observations of one scan, neither of a known landmark, are of one landmark."""
        if one.is_wall != other.is_wall:
            return False
        if not one.is_wall:
            return math.dist(one.z, other.z) <= self._config.new_separation_m
        here, wall = Pose(), np.ones(1, dtype=bool)
        extent = ends(here, other)[None]
        distances = Distances.between(ends(here, one)[None], one.z[:1], wall, other.z[None], wall, extent)
        if distances.apart(self._config)[0, 0]:
            return False
        return disagreement(one.z, other.z, one.cov + other.cov) <= self._config.match_gate
