"""Which observations of a keyframe are of known landmarks, and which are of new ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.association.crookedness import noise_of_pairs
from sixthsense.slam.association.joint_assignment import Indices, best_matches, squared_given
from sixthsense.slam.association.matching import Innovations, compare, matches_nis
from sixthsense.slam.association.observed import Distances, Mask, Observed
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators.base import Belief

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
    joint: Array
    """(3 + 2k, 3 + 2k) covariance of the pose and these"""
    innovation: Innovations | None
    """against these; None: there are none"""
    pose: Pose
    """that the matches imply"""

    def nis(self, known: Mapping[LandmarkId, Observation]) -> float:
        """Normalised innovation squared of the matched observations together."""
        if self.innovation is None or not known:
            return 0.0
        place = {i: j for j, i in enumerate(self.near.tolist())}
        cols = np.array([place[i] for i in known])
        return matches_nis(self.innovation, list(known.values()), cols, self.joint)


def match(
    observations: Sequence[Observation],
    observed: Observed,
    belief: Belief,
    extents: Array,
    records: Mapping[LandmarkId, Record],
    excess: tuple[float, float],
    cfg: AssociationConfig,
) -> Matches:
    """The set of matches that explains a keyframe best, and which of the other observations are new given these.

    `observed` are the arrays of the observations, `extents` (n, 2, 2) ends of the belief's walls, and
    `excess` says how crooked walls are in the mean. The `records` of landmarks that were compared are told how certain
    these are.
    """
    m, estimate = len(observations), belief.estimate()
    own = [records[i] for i in estimate.ids.tolist()]
    known_sigmas = np.array([record.sigma_m for record in own])
    sigmas = observed.sigmas_m(estimate.pose_cov)
    distances = Distances.at(estimate.pose, observed, estimate, extents)
    plausible = distances.plausible(sigmas, known_sigmas, math.sqrt(estimate.pose_cov[2, 2]), cfg)
    near = np.flatnonzero(plausible.any(axis=0))
    joint = belief.joint_covariance(estimate.ids[near].tolist())
    if not len(near):
        return Matches(np.full(m, -1), np.asarray(distances.apart(cfg).all(axis=1)), near, joint, None, estimate.pose)
    for j, k in enumerate(near):
        own[k].sigma_m = math.sqrt(joint[3 + 2 * j, 3 + 2 * j] + joint[4 + 2 * j, 4 + 2 * j])
    squares = np.array([own[k].shape.square_m2(excess) for k in near])
    innovation = compare(observed, noise_of_pairs(observations, squares), estimate, near, joint)
    plausible = plausible[:, near]
    inside = plausible & (innovation.squared < cfg.match_gate)
    covered, coverable = distances.covered(np.zeros(m))[:, near], distances.covered(2.0 * sigmas)[:, near]
    penalty = _lacking(innovation.log_det, inside) + _beyond(covered, coverable, inside)
    found = best_matches(innovation.pairs, plausible, penalty, innovation.walls, cfg.match_gate)
    is_matched = found >= 0
    is_far = ~is_matched & (squared_given(innovation.pairs, plausible, found).min(axis=1) > cfg.new_gate)
    here = innovation.pose_given(estimate.pose, joint, found)
    is_apart = Distances.at(here, observed, estimate, extents).apart(cfg).all(axis=1)
    is_beside = is_far & ~is_apart & observed.walls
    # Walls beside known ones are other walls if most of the scan matches, and else show that the pose is wrong.
    contradicting = np.count_nonzero(~is_matched & ~(is_far & is_apart))
    if np.count_nonzero(is_matched) > contradicting:
        is_apart |= is_beside
    landmark = np.where(is_matched, estimate.ids[near][found], -1)
    return Matches(landmark, is_far & is_apart, estimate.ids[near], joint, innovation, here)


def _lacking(log_det: Array, inside: Mask) -> Array:
    """(m, k) logarithm of the density of the densest match inside the gate over that of each match, at least 0.

    A landmark that is less certain than another one in the gate explains an observation less by as much.
    """
    densest = np.where(inside, log_det, np.inf).min(axis=1, initial=np.inf)
    return np.asarray(np.maximum(log_det - densest[:, None], 0.0))


def _beyond(covered: Array, coverable: Array, inside: Mask) -> Array:
    """(m, k) twice the logarithm of how much rarer it is that an observation shows so much of an unknown stretch.

    `covered` (m, k) is the share of an observation on what is known of the landmark, `coverable` that share if the
    robot is as far from its estimate as two sigmas. It is compared with the landmark in the gate that covers most. Two
    walls that meet at a small angle are one beside the other where they meet, and a short piece of the one passes the
    gate of both, though it lies beyond what is known of the other.
    """
    most = np.where(inside, covered, 0.0).max(axis=1, initial=0.0)
    share = np.maximum(coverable, _EXTENDED)
    return np.asarray(2.0 * np.log(np.maximum(np.maximum(most, _EXTENDED)[:, None] / share, 1.0)))
