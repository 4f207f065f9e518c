"""Innovations of observations against landmarks (report section 4.3), and which observation is of which landmark."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import innovation, innovations_of, predictions
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.se2 import Triple
from sixthsense.slam.association.joint_assignment import (
    Indices,
    Pairs,
    best_matches,
    likely_matches,
    squared_given,
)
from sixthsense.slam.association.observed import Distances, Mask, Observed
from sixthsense.slam.association.records import Record, unit_cov
from sixthsense.slam.association.unknown import least_densities
from sixthsense.slam.estimators.base import Belief, Estimate

_EXTENDED = 0.01
"""share of the observations of a wall that show a stretch of it that was not seen before"""


class Usual(NamedTuple):
    """What the landmarks of this building are like, by all that was observed so far."""

    excess: tuple[float, float]
    """how crooked walls are, as of `Crookedness`"""
    unknown_per_m2: float
    """density of unknown points"""


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
        if not observations:
            return 0.0
        z, cov = np.array([s.z for s in observations]), np.array([s.cov for s in observations])
        values, noise = innovations_of(z, cov, self.predicted[landmarks], self.walls[landmarks])
        return _nis(values, _joint(self.pairs.predicted, _places(landmarks), noise))


def compare(observed: Observed, squares_m2: Array, estimate: Estimate, near: Indices, joint: Array) -> Innovations:
    """Innovations of all observations against the landmarks at `near` (k,), whose covariance with the pose is `joint`.

    The walls among these deviate from straight ones by a mean square of `squares_m2` (k,).
    """
    pose = estimate.pose.x, estimate.pose.y, estimate.pose.theta
    return _compared(observed, squares_m2, pose, estimate.landmarks[near], estimate.walls[near], joint)


def compare_known(
    observations: Mapping[LandmarkId, Observation], known: list[LandmarkId], estimate: Estimate, estimator: Belief
) -> Innovations:
    """Innovations of the observations of landmarks that are known."""
    order = {i: k for k, i in enumerate(estimate.ids.tolist())}
    near, seen = np.array([order[i] for i in known]), Observed.of([observations[i] for i in known])
    return compare(seen, np.zeros(len(known)), estimate, near, estimator.joint_covariance(known))


@numba.njit(cache=True, error_model="numpy")
def _compared(
    observed: Observed, squares_m2: Array, pose: Triple, landmarks: Array, walls: Mask, joint: Array
) -> Innovations:
    m, k = len(observed.z), len(landmarks)
    predicted, by_pose, by_landmark = predictions(pose, landmarks, walls)
    with_state = _by_state(by_pose, by_landmark, joint)
    predicted_cov = _by_state(by_pose, by_landmark, np.ascontiguousarray(with_state.T))
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
    return Innovations(pairs, squared, log_det, np.ascontiguousarray(with_state[:, :3]), predicted, walls)


@numba.njit(cache=True, error_model="numpy")
def _by_state(by_pose: Array, by_landmark: Array, of_state: Array) -> Array:
    """(2k, c) the Jacobian of k predicted observations by the pose and the landmarks, times `of_state` (3 + 2k, c)."""
    k, columns = len(by_pose), of_state.shape[1]
    out = np.zeros((2 * k, columns))
    for row in range(2 * k):
        j, a = row // 2, row % 2
        for c in range(columns):
            for p in range(3):
                out[row, c] += by_pose[j, a, p] * of_state[p, c]
            for p in range(2):
                out[row, c] += by_landmark[j, a, p] * of_state[3 + 2 * j + p, c]
    return out


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
    near: Indices
    """(k,) ids of the landmarks that were compared"""
    innovations: Innovations | None
    """against these; None: there are none"""
    pose: Pose
    """that the matches imply"""
    worth: float
    """twice the logarithm of how much likelier they are than observations at the gate"""

    @property
    def places(self) -> dict[LandmarkId, int]:
        """The places of the landmarks that were compared among these."""
        return {i: j for j, i in enumerate(self.near.tolist())}

    def nis(self, known: Mapping[LandmarkId, Observation]) -> float:
        """Normalised innovation squared of the matched observations together."""
        if self.innovations is None or not known:
            return 0.0
        places = self.places
        return self.innovations.nis(list(known.values()), np.array([places[i] for i in known]))


def match(
    observed: Observed,
    belief: Belief,
    estimate: Estimate,
    extents: Array,
    records: Mapping[LandmarkId, Record],
    usual: Usual,
    cfg: AssociationConfig,
) -> Matches:
    """The set of matches that explains a keyframe best, and which of the other observations are new given these.

    `observed` are the arrays of the observations, `estimate` is that of `belief`, `extents` (n, 2, 2) are the ends of
    its walls, and `usual` says what landmarks are like. The `records` of those that were compared are told how certain
    these are.
    """
    m = len(observed.z)
    own = [records[i] for i in estimate.ids.tolist()]
    known_sigmas = np.array([record.sigma_m for record in own])
    sigmas = observed.sigmas_m(estimate.pose_cov)
    distances = Distances.at(estimate.pose, observed, estimate, extents)
    plausible = distances.plausible(sigmas, known_sigmas, math.sqrt(estimate.pose_cov[2, 2]), cfg)
    near = np.flatnonzero(plausible.any(axis=0))
    joint = np.ascontiguousarray(belief.joint_covariance(estimate.ids[near].tolist()))
    if not len(near):
        return Matches(np.full(m, -1), np.asarray(distances.apart(cfg).all(axis=1)), near, None, estimate.pose, 0.0)
    for j, k in enumerate(near.tolist()):
        own[k].sigma_m = math.sqrt(joint[3 + 2 * j, 3 + 2 * j] + joint[4 + 2 * j, 4 + 2 * j])
    squares = np.array([own[k].shape.square_m2(usual.excess) for k in near.tolist()])
    innovations = compare(observed, squares, estimate, near, joint)
    gaps, plausible = distances.gap_m[:, near], plausible[:, near]
    penalty = _penalties(innovations, plausible, cfg.match_gate, gaps, distances.length_m, 2.0 * sigmas)
    found = best_matches(innovations.pairs, plausible, penalty, innovations.walls, cfg.match_gate)
    least = least_densities(usual.unknown_per_m2, innovations.walls, cfg.match_odds)
    found = likely_matches(innovations.pairs, found, least)
    is_matched = found >= 0
    is_far = ~is_matched & (squared_given(innovations.pairs, plausible, found).min(axis=1) > cfg.new_gate)
    here = innovations.pose_given(estimate.pose, found)
    is_new = _new_ones(observed, replace(estimate, pose=here), extents, is_matched, is_far, cfg)
    landmark = np.where(is_matched, estimate.ids[near][found], -1)
    worth = innovations.worth(found, cfg.match_gate)
    return Matches(landmark, is_new, estimate.ids[near], innovations, here, worth)


def _new_ones(
    observed: Observed, estimate: Estimate, extents: Array, is_matched: Mask, is_far: Mask, cfg: AssociationConfig
) -> Mask:
    """(m,) which observations are of new landmarks.

    The estimate has the pose that the matches imply. `is_matched` and `is_far` (m,) mark observations, the latter those
    outside of the gate of all landmarks.
    """
    is_beside = ~Distances.at(estimate.pose, observed, estimate, extents).apart(cfg)
    is_apart = ~is_beside.any(axis=1)
    contradicting = np.count_nonzero(~is_matched & ~(is_far & is_apart))
    # Where most of the scan matches, a wall may be beside a known one; else these show that the pose is wrong.
    may_be_beside = observed.walls & (np.count_nonzero(is_matched) > contradicting)
    return is_far & (is_apart | may_be_beside)


@numba.njit(cache=True, error_model="numpy")
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
    m, k = plausible.shape
    out = np.empty((m, k))
    for i in range(m):
        densest, most = np.inf, _EXTENDED
        for j in range(k):
            if plausible[i, j] and innovations.squared[i, j] < gate:
                densest = min(densest, innovations.log_det[i, j])
                most = max(most, _covered(gaps[i, j], lengths[i], 0.0))
        for j in range(k):
            lacking = max(innovations.log_det[i, j] - densest, 0.0)
            share = max(_covered(gaps[i, j], lengths[i], slacks[i]), _EXTENDED)
            out[i, j] = lacking + 2.0 * math.log(max(most / share, 1.0))
    return out


@numba.njit(cache=True, error_model="numpy")
def _covered(gap: float, length: float, slack: float) -> float:
    """Share, 0 to 1, of an observed wall on what is known of the landmark, after a shift by `slack`; 1 of a point."""
    return min(max((slack - gap) / length, 0.0), 1.0) if length > 0.0 else 1.0
