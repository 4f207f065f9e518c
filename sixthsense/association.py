"""Data association: which sighting is of which landmark, which is new, and which landmarks to forget.

One piece of code for all estimators: it asks them for nothing but `estimate` and `joint_covariance`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from sixthsense.config import AssociationConfig
from sixthsense.estimators.base import Estimate, Estimator
from sixthsense.geometry import Array
from sixthsense.landmarks import Kind, LandmarkId, Sighting, predict_points

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


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


@dataclass(slots=True, eq=False)
class _Candidate:
    position: Array  # (2,), world frame, where it was last seen
    sightings: int
    last_scan: int


@dataclass(slots=True)
class Record:
    """What is known of a landmark beside its two numbers."""

    kind: Kind
    """of its first sighting"""
    sightings: int
    """updates it has received, its birth included"""
    born_scan: int
    """key scan of its birth"""
    sigma_m: float = math.inf
    """at most that of its position along any direction, when it was last looked at"""


class Associator:
    """Gates and assigns sightings, keeps candidates until they have proved themselves, and culls bad landmarks."""

    def __init__(self, config: AssociationConfig) -> None:
        self._config = config
        self._known_gate = float(chi2.ppf(config.known_probability, 2))  # infinite for 1
        self._candidates: list[_Candidate] = []
        self._next_id = 0
        self._scan = 0
        self.records: dict[LandmarkId, Record] = {}
        """of every landmark in the state"""
        self.culled = 0
        """landmarks removed so far"""
        if config.method == "chi2":
            self._match_gate = float(chi2.ppf(config.match_probability, 2))
            self._new_gate = float(chi2.ppf(config.new_probability, 2))
        else:
            self._match_gate, self._new_gate = config.match_below, config.new_above
        self._sigmas = math.sqrt(max(self._match_gate, self._new_gate))

    def associate(self, sightings: Sequence[Sighting], estimator: Estimator) -> Association:
        """Match sightings one-to-one with the landmarks by innovation; what fits none is a candidate or a landmark."""
        self._scan += 1
        self._candidates = [c for c in self._candidates if self._scan - c.last_scan <= self._config.candidate_scans]
        estimate = estimator.estimate()
        if not sightings:
            return Association({}, 0, 0.0, 0)
        positions = estimate.pose @ np.array([s.z for s in sightings])  # (m, 2)
        sigmas = _sigmas(sightings, estimate)
        gap = positions[:, None, :] - estimate.landmarks[None, :, :]
        distance = np.hypot(gap[..., 0], gap[..., 1])  # (m, n)
        near = self._near(distance, sigmas, estimate)
        if len(near) == 0:
            known: dict[LandmarkId, Sighting] = {}
            nis, fits_none = 0.0, np.ones(len(sightings), dtype=bool)
            taken = np.zeros(len(sightings), dtype=bool)
        else:
            joint = estimator.joint_covariance(estimate.ids[near].tolist())
            known, taken, fits_none, nis = self._match(sightings, estimate, near, joint)
        if len(estimate.ids):
            fits_none = fits_none & (distance.min(axis=1) > self._config.new_separation_m)
        for i in known:
            self.records[i].sightings += 1
        accepted = dict(known)
        born: list[Array] = []
        for k in np.flatnonzero(~taken & fits_none).tolist():
            # One scan may show a wall's end from both sides: one landmark, not two.
            apart = all(math.dist(positions[k], other) > self._config.new_separation_m for other in born)
            if apart and self._proves_itself(positions[k]):
                born.append(positions[k])
                accepted[self._next_id] = sightings[k]
                self.records[self._next_id] = Record(sightings[k].kind, 1, self._scan, float(sigmas[k]))
                self._next_id += 1
        return Association(accepted, len(sightings) - len(accepted), nis, 2 * len(known))

    def known(self, sightings: Mapping[LandmarkId, Sighting], estimator: Estimator) -> Association:
        """Take sightings whose landmarks are known by name, unless it was misread; the NIS is that of the old ones."""
        self._scan += 1
        estimate = estimator.estimate()
        order = {i: k for k, i in enumerate(estimate.ids.tolist())}
        old = [i for i in sightings if i in order]
        misread: set[LandmarkId] = set()
        nis = 0.0
        if old:
            means = estimate.landmarks[[order[i] for i in old]]
            predicted, by_pose, by_landmark = predict_points(estimate.pose, means)
            innovation = np.array([sightings[i].z for i in old]) - predicted
            noise = np.array([sightings[i].cov for i in old])
            joint = estimator.joint_covariance(old)
            S = _predicted_covs(joint, by_pose, by_landmark) + noise  # (k, 2, 2)
            mahalanobis_sq = np.einsum("ki,ki->k", innovation, np.linalg.solve(S, innovation[..., None])[..., 0])
            kept = np.flatnonzero(mahalanobis_sq <= self._known_gate)
            misread = set(old) - {old[k] for k in kept}
            nis = _joint_nis(joint, by_pose[kept], by_landmark, kept, innovation[kept], noise[kept])
        accepted = {i: sighting for i, sighting in sightings.items() if i not in misread}
        for i, sighting in accepted.items():
            record = self.records.setdefault(i, Record(sighting.kind, 0, self._scan))
            record.sightings += 1
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

    def _near(self, distance: Array, sigmas: Array, estimate: Estimate) -> Indices:
        """Indices of landmarks that any sighting may be of, by (m, n) distances, and sightings' (m,) world sigmas.

        The sigma of a difference is at most the sum of both, however they are correlated: what is left out here could
        not have passed a gate. Sigmas of landmarks shrink; the factor leaves room for what linearising anew changes.
        """
        own = np.array([self.records[i].sigma_m for i in estimate.ids.tolist()])
        reach = np.minimum(self._config.pre_gate_m, self._sigmas * (sigmas[:, None] + 2.0 * own[None, :]))
        return np.flatnonzero((distance < reach).any(axis=0))

    def _match(
        self, sightings: Sequence[Sighting], estimate: Estimate, near: Indices, joint: Array
    ) -> tuple[dict[LandmarkId, Sighting], Mask, Mask, float]:
        """Matches by id, (m,) whether matched, (m,) whether far from every landmark, and the matches' NIS."""
        for j, i in enumerate(estimate.ids[near].tolist()):
            self.records[i].sigma_m = math.sqrt(joint[3 + 2 * j, 3 + 2 * j] + joint[4 + 2 * j, 4 + 2 * j])
        predicted, by_pose, by_landmark = predict_points(estimate.pose, estimate.landmarks[near])
        z = np.array([s.z for s in sightings])
        noise = np.array([s.cov for s in sightings])
        innovation = z[:, None, :] - predicted[None, :, :]  # (m, k, 2)
        S = _predicted_covs(joint, by_pose, by_landmark)[None] + noise[:, None]  # (m, k, 2, 2)
        det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
        a, b = innovation[..., 0], innovation[..., 1]
        mahalanobis_sq = (a * a * S[..., 1, 1] - 2 * a * b * S[..., 0, 1] + b * b * S[..., 0, 0]) / det
        inside = mahalanobis_sq < self._match_gate
        # The likelier landmark wins: the distance alone would favour the one that is less well known.
        cost = np.where(inside, mahalanobis_sq + np.log(det), 1e6)
        rows, cols = linear_sum_assignment(cost)
        paired = inside[rows, cols]
        rows, cols = rows[paired], cols[paired]
        taken = np.zeros(len(sightings), dtype=bool)
        taken[rows] = True
        fits_none = mahalanobis_sq.min(axis=1) > self._new_gate
        known = {int(estimate.ids[near[j]]): sightings[i] for i, j in zip(rows, cols, strict=True)}
        nis = _joint_nis(joint, by_pose[cols], by_landmark, cols, innovation[rows, cols], noise[rows])
        return known, taken, fits_none, nis

    def _proves_itself(self, position: Array) -> bool:
        """Count a sighting that fits no landmark; True when its candidate has been seen often enough."""
        needed = self._config.candidate_sightings
        if needed == 1:
            return True
        for candidate in self._candidates:
            if math.dist(candidate.position, position) < self._config.candidate_gate_m:
                if candidate.last_scan == self._scan:
                    return False  # two sightings of one scan are not two of one landmark
                candidate.position = position
                candidate.sightings += 1
                candidate.last_scan = self._scan
                if candidate.sightings >= needed:
                    self._candidates.remove(candidate)
                    return True
                return False
        self._candidates.append(_Candidate(position, 1, self._scan))
        return False


def _sigmas(sightings: Sequence[Sighting], estimate: Estimate) -> Array:
    """(m,) sigma, along any direction at most, of where the sightings lie in the world; m."""
    own = np.array([np.trace(s.cov) for s in sightings])
    reach = np.array([math.hypot(*s.z) for s in sightings])
    cov = estimate.pose_cov
    return np.asarray(math.sqrt(cov[0, 0] + cov[1, 1]) + reach * math.sqrt(cov[2, 2]) + np.sqrt(own))


def _predicted_covs(joint: Array, by_pose: Array, by_landmark: Array) -> Array:
    """(k, 2, 2): H Sigma H^T of each landmark's sighting, from the joint covariance of pose and landmarks."""
    k = len(by_pose)
    own = joint[3:, 3:].reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :]
    cross = joint[:3, 3:].reshape(3, k, 2).transpose(1, 0, 2)  # (k, 3, 2)
    mixed = by_pose @ cross @ by_landmark.T
    pose_part = by_pose @ joint[:3, :3] @ by_pose.transpose(0, 2, 1)
    return np.asarray(pose_part + mixed + mixed.transpose(0, 2, 1) + by_landmark @ own @ by_landmark.T)


def _joint_nis(
    joint: Array, by_pose: Array, by_landmark: Array, cols: Indices, innovation: Array, noise: Array
) -> float:
    """Normalised innovation squared of all matches, with the correlations between them."""
    m = len(cols)
    if m == 0:
        return 0.0
    H = np.zeros((2 * m, len(joint)))
    S = np.zeros((2 * m, 2 * m))
    for k, j in enumerate(cols):
        H[2 * k : 2 * k + 2, :3] = by_pose[k]
        H[2 * k : 2 * k + 2, 3 + 2 * j : 5 + 2 * j] = by_landmark
        S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = noise[k]
    S += H @ joint @ H.T
    stacked = innovation.ravel()
    return float(stacked @ np.linalg.solve(S, stacked))
