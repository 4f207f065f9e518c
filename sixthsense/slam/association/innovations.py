"""Innovations of observations against landmarks (report section 4.3), and which observation is of which landmark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import innovation, innovations_of, predictions, stacked
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.association.joint_assignment import Indices, Pairs, best_matches, squared_given
from sixthsense.slam.association.observed import Distances, Mask, Observed, offset_variance
from sixthsense.slam.association.records import ByLandmark, unit_cov
from sixthsense.slam.estimators.base import Belief, Estimate

_EXTENDED = 0.01
"""share of the observations of a wall that show a stretch of it that was not seen before"""
RARE = 27.6
"""2 ln 10^6: how rare slips are, and wrong poses from which landmarks lie alike"""
_NO_SLIP = np.zeros((3, 3))


class Innovations(NamedTuple):
    """Innovations of m observations against k landmarks, for all pairs."""

    pairs: Pairs
    """with their covariances"""
    squared: Array
    """(m, k) squared Mahalanobis distance"""
    log_det: Array
    """(m, k) logarithm of the determinant of the innovation's covariance"""
    with_pose: Array
    """(2k, 3) covariance of the predicted observations with the pose"""
    predicted: Array
    """(k, 2) predicted observations"""
    walls: Mask
    """(k,) which of the landmarks are walls"""

    def pose_given(self, pose: Pose, matched: Indices) -> Pose:
        """The predicted `pose` updated with matches (m,), -1: none; report eq. 10."""
        values, S, places = self._together(matched)
        x, y, theta = (np.linalg.solve(S, values) @ self.with_pose[places]).tolist()
        return Pose(pose.x + x, pose.y + y, pose.theta + theta)

    @property
    def own(self) -> Array:
        """(k, 2, 2) covariance of each predicted observation."""
        k = np.arange(len(self.predicted))
        return self.pairs.predicted.reshape(len(k), 2, len(k), 2)[k, :, k]

    def innovation(self, wall: Observation, place: int) -> tuple[Array, Array, Array]:
        """Innovation (2,) of a wall, its covariance (2, 2) were the wall straight, and what 1 m^2 adds to that."""
        at, is_wall = slice(place, place + 1), np.ones(1, dtype=bool)
        values, noise = innovations_of(wall.z[None], wall.cov[None], self.predicted[at], is_wall)
        return values[0], self.own[place] + noise[0], unit_cov(*wall.extent, True)

    def worth(self, matched: Indices, gate: float) -> float:
        """Of matches (m,), -1: none: the gate for each, less their squared innovation together."""
        values, S, _ = self._together(matched)
        return gate * np.count_nonzero(matched >= 0) - _nis(values, S)

    def _together(self, matched: Indices) -> tuple[Array, Array, Indices]:
        """Innovations (2n,) of matches (m,), -1: none, their covariance, and the places of their predictions."""
        rows = np.flatnonzero(matched >= 0)
        cols, places = matched[rows], _places(matched[rows])
        S = _joint(self.pairs.predicted, places, self.pairs.noise[rows, cols])
        return self.pairs.values[rows, cols].ravel(), S, places

    def nis(self, observations: Sequence[Observation], landmarks: Indices) -> float:
        """Normalised innovation squared of observations of the `landmarks` (n,), with the correlations between them.

        The observations need not be those that were compared.
        """
        seen = Observed.of(observations)
        values, noise = innovations_of(seen.z, seen.cov, self.predicted[landmarks], self.walls[landmarks])
        return _nis(values, _joint(self.pairs.predicted, _places(landmarks), noise))


def compare(observed: Observed, squares_m2: Array, estimate: Estimate, near: Indices, joint: Array) -> Innovations:
    """Innovations of all observations against the landmarks at `near` (k,), whose covariance with the pose is `joint`.

    The walls among these deviate from straight ones by a mean square of `squares_m2` (k,).
    """
    walls = estimate.walls[near]
    predicted, by_pose, by_landmark = predictions(estimate.pose.triple(), estimate.landmarks[near], walls)
    H = stacked(by_pose, by_landmark, 3)
    with_state = H @ joint
    return _compared(observed, squares_m2, predicted, walls, with_state @ H.T, with_state[:, :3].copy())


def compare_known(seen: ByLandmark, known: list[LandmarkId], estimate: Estimate, estimator: Belief) -> Innovations:
    """Innovations of what was seen of landmarks that are known."""
    order = {i: k for k, i in enumerate(estimate.ids.tolist())}
    near, observed = np.array([order[i] for i in known], dtype=np.int64), Observed.of([seen[i] for i in known])
    return compare(observed, np.zeros(len(known)), estimate, near, estimator.joint_covariance(known))


@numba.njit(cache=True, error_model="numpy")
def _compared(
    observed: Observed, squares_m2: Array, predicted: Array, walls: Mask, predicted_cov: Array, with_pose: Array
) -> Innovations:
    m, k = len(observed.z), len(predicted)
    values, noise, own = np.empty((m, k, 2)), np.empty((m, k, 2, 2)), np.empty((2, 2))
    squared, log_det = np.empty((m, k)), np.empty((m, k))
    for i in range(m):
        of_shape = unit_cov(observed.extents[i, 0], observed.extents[i, 1], observed.walls[i])
        for j in range(k):
            for row in range(2):
                for column in range(2):
                    own[row, column] = observed.cov[i, row, column] + squares_m2[j] * of_shape[row, column]
            innovation(observed.z[i], own, predicted[j], walls[j], values[i, j], noise[i, j])
            a, b = values[i, j, 0], values[i, j, 1]
            s00 = predicted_cov[2 * j, 2 * j] + noise[i, j, 0, 0]
            s10 = predicted_cov[2 * j + 1, 2 * j] + noise[i, j, 1, 0]
            s11 = predicted_cov[2 * j + 1, 2 * j + 1] + noise[i, j, 1, 1]
            det = s00 * s11 - s10 * s10
            squared[i, j] = (a * a * s11 - 2.0 * a * b * s10 + b * b * s00) / det
            log_det[i, j] = np.log(det)
    pairs = Pairs(values, noise, predicted_cov)
    return Innovations(pairs, squared, log_det, with_pose, predicted, walls)


def _joint(predicted_cov: Array, places: Indices, noise: Array) -> Array:
    """(2n, 2n) covariance of the innovations with `noise` (n, 2, 2) of predictions at `places` (2n,) together."""
    S, each = predicted_cov[places[:, None], places], np.arange(len(noise))
    S.reshape(len(noise), 2, len(noise), 2)[each, :, each] += noise
    return S


def _places(landmarks: Indices) -> Indices:
    """(2n,) of the predictions of `landmarks` (n,) among those of all."""
    return np.asarray((2 * landmarks[:, None] + np.arange(2)).ravel())


def _nis(values: Array, S: Array) -> float:
    flat = values.ravel()
    return float(flat @ np.linalg.solve(S, flat))


class Matches(NamedTuple):
    """Of m observations, those of known landmarks and those of new ones."""

    landmark: Indices
    """(m,) id; -1: none"""
    is_new: Mask
    """(m,)"""
    compared: Indices
    """(k,) ids of the landmarks that were compared"""
    innovations: Innovations
    """against these"""
    pose: Pose
    """`T_world_robot` that the matches imply"""
    worth: float
    """log-likelihood ratio of the matches against observations at the gate, times two"""

    @property
    def matched(self) -> int:
        """Number of observations that are matched."""
        return int(np.count_nonzero(self.landmark >= 0))


def match(
    observed: Observed,
    belief: Belief,
    estimate: Estimate,
    extents: Array,
    squares_m2: Array,
    cfg: AssociationConfig,
    slip_cov: Array = _NO_SLIP,
) -> Matches:
    """The set of matches that explains a keyframe best, and which of the other observations are new given these.

    `observed` are the arrays of the observations, `estimate` (n landmarks) is that of `belief`; `extents` (n, 2, 2) are
    the ends of its walls, world frame, `squares_m2` (n,) their deviations from straight ones, and `slip_cov` (3, 3) is
    added to the covariance of the pose. Nothing is recorded.
    """
    estimate = replace(estimate, pose_cov=estimate.pose_cov + slip_cov)
    sigmas = observed.sigmas_m(estimate.pose_cov)
    distances = Distances.at(estimate.pose, observed, estimate, extents)
    plausible = distances.plausible(sigmas, math.sqrt(estimate.pose_cov[2, 2]), cfg)
    near = np.flatnonzero(plausible.any(axis=0))
    ids = estimate.ids[near]
    joint = np.ascontiguousarray(belief.joint_covariance(ids.tolist()))
    joint[:3, :3] += slip_cov
    innovations = compare(observed, squares_m2[near], estimate, near, joint)
    gaps, plausible = distances.gap_m[:, near], np.ascontiguousarray(plausible[:, near])
    penalty = _penalties(innovations, plausible, cfg.match_gate, gaps, distances.length_m, 2.0 * sigmas)
    found = best_matches(innovations.pairs, plausible, penalty, innovations.walls, cfg.match_gate)
    if cfg.proposed_by == "estimate" and not slip_cov.any():  # a slip has its price
        found = _without_unlikely(observed, innovations, found, cfg)
    is_matched = found >= 0
    nearest = squared_given(innovations.pairs, plausible, found).min(axis=1, initial=math.inf)
    is_far = ~is_matched & (nearest > cfg.new_gate)
    here = innovations.pose_given(estimate.pose, found)
    is_apart = np.asarray(Distances.at(here, observed, estimate, extents).apart(cfg).all(axis=1))
    is_new = _new_ones(is_matched, is_far, is_apart)
    worth = innovations.worth(found, cfg.match_gate)
    landmark = np.full(len(found), -1)
    landmark[is_matched] = ids[found[is_matched]]
    return Matches(landmark, is_new, ids, innovations, here, worth)


def _without_unlikely(observed: Observed, innovations: Innovations, found: Indices, cfg: AssociationConfig) -> Indices:
    """(m,) the matches without those of walls whose gate is wider than walls are apart, if too few of them agree.

    A gate as wide as that holds other walls, too. Two walls at right angles agree wherever the robot is: what matches
    close a loop with is what they leave beyond what the pose's uncertainty adds to their covariance together.
    """
    walls = np.flatnonzero((found >= 0) & observed.walls)
    variances = offset_variance(innovations.own[found[walls]], observed.extents[walls].mean(axis=1))
    wide = walls[cfg.match_gate * variances > cfg.new_separation_m**2]
    noise, places = innovations.pairs.noise[wide, found[wide]], _places(found[wide])
    spent = np.linalg.slogdet(_joint(innovations.pairs.predicted, places, noise))[1] - np.linalg.slogdet(noise)[1].sum()
    if cfg.match_gate * len(set(found[wide].tolist())) - spent < RARE:
        found[wide] = -1
    return found


def _new_ones(is_matched: Mask, is_far: Mask, is_apart: Mask) -> Mask:
    """(m,) which observations are of new landmarks.

    Arrays (m,) mark those that are matched, that are outside of the gate of all landmarks, and that are apart from all
    of them as seen from the pose that the matches imply.
    """
    contradicting = np.count_nonzero(~is_matched & ~(is_far & is_apart))
    # Where most of the scan matches, a landmark may be beside a known one, as the other face of a thin wall and its end
    # are; else those that do not match show that the pose is wrong.
    return is_far & (is_apart | (np.count_nonzero(is_matched) > contradicting))


def _penalties(
    innovations: Innovations, plausible: Mask, gate: float, gaps: Array, lengths: Array, slacks: Array
) -> Array:
    """(m, k) twice the logarithm of how much rarer each match is than the likeliest inside the gate, at least 0.

    A landmark that is less certain than another one in the gate explains an observation less, by the logarithm of its
    density. And an observation seldom shows so much of an unknown stretch: the share of it on what is known of the
    landmark, shifted by `slacks` (m,), if the robot is as far from its estimate as two sigmas, is compared with that on
    the landmark in the gate that covers most. Two walls that meet at a small angle are one beside the other where they
    meet, and a short piece of the one passes the gate of both, though it lies beyond what is known of the other.
    """
    inside = plausible & (innovations.squared < gate)
    densest = np.where(inside, innovations.log_det, np.inf).min(axis=1, initial=np.inf)
    most = np.where(inside, _covered(gaps, lengths, 0.0 * slacks), 0.0).max(axis=1, initial=_EXTENDED)
    lacking = np.maximum(innovations.log_det - densest[:, None], 0.0)
    share = np.maximum(_covered(gaps, lengths, slacks), _EXTENDED)
    return np.asarray(lacking + 2.0 * np.log(np.maximum(most[:, None] / share, 1.0)))


def _covered(gaps: Array, lengths: Array, slacks: Array) -> Array:
    """(m, k) share, 0 to 1, of observed walls on what is known of landmarks, after shifts by `slacks`; 1 of a point."""
    lengths = lengths[:, None]
    shares = (slacks[:, None] - gaps) / np.where(lengths > 0.0, lengths, 1.0)
    return np.where(lengths > 0.0, np.clip(shares, 0.0, 1.0), 1.0)
