"""Which observations of a keyframe are of known landmarks, and which are of new ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.association.joint_assignment import Indices, best_matches, squared_given
from sixthsense.slam.association.matching import Innovations, compare
from sixthsense.slam.association.observed import Distances, Mask, Observed
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators.base import Belief, Estimate

_EXTENDED = 0.01
"""share of the observations of a wall that show a stretch of it that was not seen before"""


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

    def nis(self, known: Mapping[LandmarkId, Observation]) -> float:
        """Normalised innovation squared of the matched observations together."""
        if self.innovations is None or not known:
            return 0.0
        place = {i: j for j, i in enumerate(self.near.tolist())}
        return self.innovations.nis(list(known.values()), np.array([place[i] for i in known]))


def match(
    observed: Observed,
    belief: Belief,
    estimate: Estimate,
    extents: Array,
    records: Mapping[LandmarkId, Record],
    excess: tuple[float, float],
    cfg: AssociationConfig,
) -> Matches:
    """The set of matches that explains a keyframe best, and which of the other observations are new given these.

    `observed` are the arrays of the observations, `estimate` is that of `belief`, `extents` (n, 2, 2) are the ends of
    its walls, and `excess` says how crooked walls are in the mean. The `records` of landmarks that were compared are
    told how certain these are.
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
    squares = np.array([own[k].shape.square_m2(excess) for k in near.tolist()])
    innovations = compare(observed, squares, estimate, near, joint)
    gaps, plausible = distances.gap_m[:, near], plausible[:, near]
    penalty = _penalties(innovations, plausible, cfg.match_gate, gaps, distances.length_m, 2.0 * sigmas)
    found = best_matches(innovations.pairs, plausible, penalty, innovations.walls, cfg.match_gate)
    is_matched = found >= 0
    is_far = ~is_matched & (squared_given(innovations.pairs, plausible, found).min(axis=1) > cfg.new_gate)
    here = innovations.pose_given(estimate.pose, found)
    is_apart = Distances.at(here, observed, estimate, extents).apart(cfg).all(axis=1)
    is_beside = is_far & ~is_apart & observed.walls
    # Walls beside known ones are other walls if most of the scan matches, and else show that the pose is wrong.
    contradicting = np.count_nonzero(~is_matched & ~(is_far & is_apart))
    if np.count_nonzero(is_matched) > contradicting:
        is_apart |= is_beside
    landmark = np.where(is_matched, estimate.ids[near][found], -1)
    worth = innovations.worth(found, cfg.match_gate)
    return Matches(landmark, is_far & is_apart, estimate.ids[near], innovations, here, worth)


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
