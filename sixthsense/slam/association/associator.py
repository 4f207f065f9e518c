"""Data association: which observation is of which landmark, which is new, and which landmarks to forget.

A landmark begins with an observation that is far from all known ones. It is matched while its innovation, given the
other matches of a keyframe, passes a gate. A wall is merged into one in line with it that was observed more often. A
landmark is forgotten if it is seen too rarely, if more observations that name it contradict it than agree, or if it is
of a prior map and the map of this run shows its place free.

It serves all estimators and calls only their `estimate` and `joint_covariance`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.covariance import SIGNIFICANT, chi_square_quantile, difference_covariance
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.innovations import RARE, Innovations, Matches, compare_known, match
from sixthsense.slam.association.joint_assignment import Indices
from sixthsense.slam.association.observed import Distances, Mask, Observed, disagreement, ends, fused, joined
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Association, ByLandmark, Crookedness, Record, less_certain, on_lines
from sixthsense.slam.estimators.base import Belief, Estimate, Estimator

AreFree = Callable[[Array, float], Mask]
"""(N,) whether a map shows nothing but free cells around the points (N, 2), world frame, within a distance, m"""

CULL_PERIOD = 25
"""keyframes between two looks for landmarks to forget: the robot has turned around or left the room"""
_PARTS = 10
"""of a wall's extent, at whose limits the map is asked"""
_SLIP_COV = np.diag([0.5, 0.5, 0.25]) ** 2
"""covariance of a slip, m^2 and rad^2"""
_ROUNDING_M = 1e-9
"""by which no extent is moved: one that lies on the edge of a cell stays there"""
_LEAST = 3
"""matches that determine a slip, and show whether some are wrong"""


class Associator:
    """Gates and assigns observations, starts landmarks, and forgets those that are rare, double or no longer there."""

    def __init__(
        self,
        config: AssociationConfig,
        records: Mapping[LandmarkId, Record] | None = None,
        are_free: AreFree | None = None,
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
        """walls merged into duplicates that were observed more often, not counted as culled"""
        self._crookedness = Crookedness()
        self._named_gate = float(chi_square_quantile(config.known_probability, 2))
        self._prior, self._are_free = frozenset(self.records), are_free

    def associate(
        self, observations: Sequence[Observation], estimator: Belief, proposed: ProposedLandmarks | None = None
    ) -> Association:
        """Match observations with landmarks, all at once; what is far from all landmarks is a new one.

        The landmarks lie where the estimator has them, or as `proposed`; the NIS is that of the estimator.
        """
        self._scan += 1
        if not observations:
            return Association()
        observed, estimate, slip = Observed.of(observations), estimator.estimate(), None
        belief, there = (estimator, estimate) if proposed is None else (proposed, proposed.estimate())
        records = [self.records[i] for i in there.ids.tolist()]
        extents = np.array([record.extent for record in records]) if proposed is None else proposed.extents
        squares = np.array([record.square_m2 for record in records])
        known = observed, belief, there, extents.reshape(-1, 2, 2), squares, self._config
        matches = match(*known)
        if proposed is None and np.trace(estimate.pose_cov[:2, :2]) < _SLIP_COV[0, 0] and _may_have_slipped(matches):
            # Wheels slip, and a robot is pushed. A slip pays for its size: the innovations have its covariance. Where
            # the pose is as uncertain without one, it cannot be told.
            slipped = match(*known, _SLIP_COV)
            if slipped.matched >= _LEAST and slipped.worth - RARE > matches.worth:
                matches, slip = slipped, Odometry(estimate.pose.inverse() @ slipped.pose, _SLIP_COV)
        seen = dict[LandmarkId, Observation]()
        for observation, i in zip(observations, matches.landmark.tolist(), strict=True):
            if i >= 0:
                seen[i] = fused(seen[i], observation) if i in seen else observation
        innovations, here, order = matches.innovations, matches.pose, matches.compared.tolist()
        if proposed is not None:
            innovations, order = compare_known(seen, list(seen), estimate, estimator), list(seen)
            here = innovations.pose_given(estimate.pose, np.arange(len(order)))
        places = np.array([order.index(i) for i in seen], dtype=np.int64)
        self._look(seen, innovations, places, here, estimate)
        pieces = matches.matched - len(seen)
        unmatched = [observations[k] for k in np.flatnonzero(matches.is_new).tolist()]
        new = self._started(unmatched, here)
        accepted = {i: less_certain(one, self.records[i]) for i, one in (seen | new).items()}
        discarded = len(observations) - len(accepted) - pieces
        nis = innovations.nis(list(seen.values()), places)
        return Association(accepted, discarded, nis, 2 * len(seen), pieces, slip)

    def match_named(self, observations: ByLandmark, estimator: Estimator) -> Association:
        """Match observations that name their landmark, unless the name was misread; the NIS leaves out new ones."""
        self._scan += 1
        estimate = estimator.estimate()
        known = set(estimate.ids.tolist())
        old = [i for i in observations if i in known]
        innovation = compare_known(observations, old, estimate, estimator)
        kept = np.flatnonzero(np.diag(innovation.squared) <= self._named_gate)
        misread = set(old) - {old[k] for k in kept}
        nis = innovation.nis([observations[old[k]] for k in kept], kept)
        accepted = {i: observation for i, observation in observations.items() if i not in misread}
        self._next_id = max(self._next_id, 1 + max(accepted, default=-1))
        for i in misread:
            self.records[i].misread += 1
        for i, observation in accepted.items():
            record = self.records.setdefault(i, Record(observation.kind, 0, self._scan, self._scan))
            record.observations += 1
            record.last_scan = self._scan
        return Association(accepted, len(misread), nis, 2 * (len(old) - len(misread)))

    def forgotten(self, estimator: Estimator, estimate: Estimate) -> list[LandmarkId]:
        """Landmarks to forget after an update, whose estimate is given.

        Those of which more observations were misread than not; once a period also those that were seen too rarely, that
        duplicate a wall that was observed more often, or are of a prior map and no longer there.
        """
        self._move_extents(estimate)
        is_due, merged = self._scan % CULL_PERIOD == 0, list[LandmarkId]()
        gone = {i for i, record in self.records.items() if record.misread > record.observations}
        if is_due:
            gone |= {*self._rare(), *self._vanished(estimate)}
        for i in gone:
            del self.records[i]
        self.culled += len(gone)
        if is_due:
            merged = self._merged(estimator, estimate)
            self._crookedness.update(self.records.values())
        return [*gone, *merged]

    def _move_extents(self, estimate: Estimate) -> None:
        """Move the extents of walls onto their lines as they are estimated now."""
        kept = np.flatnonzero(estimate.walls & np.isin(estimate.ids, list(self.records)))
        records = [self.records[i] for i in estimate.ids[kept].tolist()]
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        moved = on_lines(estimate.landmarks[kept], extents)
        for k in np.flatnonzero(np.abs(moved - extents).max(axis=(1, 2)) > _ROUNDING_M).tolist():
            records[k].extent = moved[k]

    def _look(
        self, seen: ByLandmark, innovations: Innovations, places: Indices, here: Pose, estimate: Estimate
    ) -> None:
        """Record what was seen of known landmarks from the pose `here`, and how crooked their new stretches are.

        `places` (n,) are those of the landmarks in the innovations.
        """
        rows = {i: k for k, i in enumerate(estimate.ids.tolist())}
        for (i, observation), place in zip(seen.items(), places.tolist(), strict=True):
            record = self.records[i]
            if observation.is_wall:
                stretch = ends(here, observation)
                record.extent = joined(estimate.landmarks[rows[i]], record.extent, stretch)
                if record.look(stretch, self._scan):
                    self._crookedness.add(record, *innovations.innovation(observation, place))
            record.observations += 1
            record.last_scan = self._scan

    def _started(self, observations: Sequence[Observation], here: Pose) -> dict[LandmarkId, Observation]:
        """New landmarks seen from the pose `here`; an end of a wall that is seen from both of its sides is one."""
        new: dict[LandmarkId, Observation] = {}
        for observation in observations:
            others = [] if observation.is_wall else [other for other in new.values() if not other.is_wall]
            if any(math.dist(observation.z, other.z) <= self._config.new_separation_m for other in others):
                continue
            record = Record(observation.kind, 1, self._scan, self._scan)
            record.square_m2 = self._crookedness.square_m2(record)
            if observation.is_wall:
                record.extent = record.stretch = ends(here, observation)
            self.records[self._next_id], new[self._next_id] = record, observation
            self._next_id += 1
        return new

    def _rare(self) -> list[LandmarkId]:
        """Landmarks that were seen too rarely a period after their first observation (report: bad landmarks)."""
        least, before = self._config.cull_below, self._scan - CULL_PERIOD
        return [i for i, record in self.records.items() if record.observations < least and record.first_scan <= before]

    def _vanished(self, estimate: Estimate) -> list[LandmarkId]:
        """Landmarks of a prior map that were not seen for a period, where the map shows the most of them free."""
        within_m = SIGNIFICANT * math.sqrt(estimate.pose_cov[0, 0] + estimate.pose_cov[1, 1])
        gone: list[LandmarkId] = []
        for i, landmark, is_wall in zip(estimate.ids.tolist(), estimate.landmarks, estimate.walls, strict=True):
            record = self.records.get(i) if i in self._prior else None
            if record is None or self._are_free is None or self._scan - record.last_scan < CULL_PERIOD:
                continue
            places = np.linspace(record.extent[0], record.extent[1], _PARTS + 1) if is_wall else landmark[None]
            if np.mean(self._are_free(places, within_m)) > 0.5:
                gone.append(i)
        return gone

    def _merged(self, estimator: Estimator, estimate: Estimate) -> list[LandmarkId]:
        """Walls that duplicate a wall that was observed more often; of two alike the first one stays.

        Two walls are one when they lie in line, without a gap, and their difference passes the gate of a match. The
        removed wall's information about the poses stays in the estimate; that both are one is not added to it.
        """
        kept = estimate.walls & np.isin(estimate.ids, list(self.records))  # some may just have been forgotten
        ids, walls = estimate.ids[kept].tolist(), estimate.landmarks[kept]
        records = [self.records[i] for i in ids]
        extents = np.array([record.extent for record in records]).reshape(-1, 2, 2)
        recent = np.array([self._scan - record.last_scan < CULL_PERIOD for record in records], dtype=bool)
        gone: list[LandmarkId] = []
        every = np.ones(len(ids), dtype=bool)
        near = ~Distances.between(extents, walls[:, 0], every, walls, every, extents).apart(self._config)
        near &= recent[:, None] & (~np.tri(len(ids), dtype=bool) | ~recent)
        for j, k in np.argwhere(near).tolist():
            if ids[j] in gone or ids[k] in gone:
                continue
            joint = estimator.joint_covariance([ids[j], ids[k]])[3:, 3:]
            if disagreement(walls[j], walls[k], difference_covariance(joint, 0, 1)) > self._config.match_gate:
                continue
            rarer, stays = sorted((j, k), key=lambda n: (records[n].observations, -ids[n]))
            records[stays].extent = joined(walls[stays], records[stays].extent, records[rarer].extent)
            records[stays].observations += records[rarer].observations
            del self.records[ids[rarer]]
            gone.append(ids[rarer])
        self.walls_merged += len(gone)
        return gone


def _may_have_slipped(matches: Matches) -> bool:
    """Whether a slip is tried: fewer than two observations match, or most are neither matched nor new."""
    shown = len(matches.landmark)
    neither = shown - matches.matched - int(np.count_nonzero(matches.is_new))
    return shown >= _LEAST and (matches.matched < _LEAST - 1 or 2 * neither > shown)
