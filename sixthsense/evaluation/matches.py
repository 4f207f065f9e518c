"""Correctness of the data association, judged by the truth; for evaluation only.

The true identity of an observation is the wall or point of the scene that its returns hit (`true_identities`). The
identity of a landmark is that of its first observation with a single identity.

The NIS of the matches is that of survivors: what a gate rejects is not in its mean. In simulation the true pairs are
known, so that their NIS has no such bias.

    observer = InnovationObserver()
    trace = run(config, on_tick=observer)
    truths, scene = np.array(trace.key_truths), true_identities(trace.scene.walls)
    laser = TrueLaser(config.laser, config.assumed.laser)
    pairs = true_pair_nis(observer.scans, trace.associations, truths, scene, laser)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import compose_jacobians
from sixthsense.core.source import Tick
from sixthsense.evaluation.true_identities import Identity, TrueLandmarks, TrueLaser, distinguished, identify
from sixthsense.record.trace import Trace
from sixthsense.slam.association.matching import compare
from sixthsense.slam.association.observed import Observed
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators.base import Estimate

Match = tuple[int, LandmarkId]
"""Keyframe, and the landmark that its observation was matched with."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Observations of a run by what the truth says of them; all that are not listed are right."""

    observations: int
    """number of observations used by the estimator"""
    wrong: tuple[Match, ...]
    """of another wall or point than the landmark"""
    spanning: tuple[Match, ...]
    """fitted to the returns of several walls, neither right nor wrong"""
    unexplained: tuple[Match, ...]
    """of nothing in the scene, neither right nor wrong"""
    left_out: tuple[Match, ...]
    """not judged, since the fit does not distinguish the walls concerned"""


def judge_matches(
    associations: Sequence[Mapping[LandmarkId, Observation]], truths: Array, scene: TrueLandmarks, laser: TrueLaser
) -> Matches:
    """Judge the observations of each keyframe, by landmark, given the true poses `truths` (K, 3) of the robot.

    An observation with another identity than its landmark is wrong, unless the observation's fit does not distinguish
    the two walls; then it is left out.
    """
    identities: dict[LandmarkId, Identity] = {}
    wrong: list[Match] = []
    listed: dict[str, list[Match]] = {"spanning": [], "unexplained": [], "left out": []}
    for k, (observations, truth) in enumerate(zip(associations, truths, strict=True)):
        pose = Pose.from_array(truth)
        position = (pose @ Pose(*laser.config.mount)).position
        seen = identify(list(observations.values()), pose, scene, laser)
        for i, one in zip(observations, seen, strict=True):
            if one.identity is None:
                listed[one.verdict].append((k, i))
                continue
            own = identities.setdefault(i, one.identity)
            if own != one.identity:
                told_apart = distinguished(own, one.identity, one, position, scene)
                (wrong if told_apart else listed["left out"]).append((k, i))
    count = sum(len(observations) for observations in associations)
    others = (tuple(listed[name]) for name in ("spanning", "unexplained", "left out"))
    return Matches(count, tuple(wrong), *others)


def landmark_identities(
    associations: Sequence[Mapping[LandmarkId, Observation]], truths: Array, scene: TrueLandmarks, laser: TrueLaser
) -> dict[LandmarkId, Identity]:
    """The identity of each landmark, as of `judge_matches`; without those that have none."""
    identities: dict[LandmarkId, Identity] = {}
    for observations, truth in zip(associations, truths, strict=True):
        new = [i for i in observations if i not in identities]
        seen = identify([observations[i] for i in new], Pose.from_array(truth), scene, laser) if new else ()
        identities |= {i: one.identity for i, one in zip(new, seen, strict=True) if one.identity is not None}
    return identities


def discarded_share(associations: Sequence[Association]) -> float:
    """Share of all observations of a run that were neither matched nor taken as new landmarks; 0 without observations.

    The NIS of the matches says nothing of these: a gate that discards what does not fit makes the rest look consistent.
    """
    discarded = sum(association.discarded for association in associations)
    used = sum(len(association.observations) + association.fused for association in associations)
    return discarded / max(discarded + used, 1)


@dataclass(frozen=True, slots=True)
class PriorInnovations:
    """All observations of a keyframe against all landmarks, before the update."""

    observations: tuple[Observation, ...]
    """m, before any was matched, fused or discarded"""
    ids: NDArray[np.int64]
    """(n,) of the landmarks"""
    squared: Array
    """(m, n) squared Mahalanobis distance of the innovation, infinite between a wall and a point"""


@dataclass(frozen=True, slots=True)
class TruePairs:
    """Observations paired with the landmarks that they truly are of."""

    nis: Array
    """(P,) normalised innovation squared before the update, 2 degrees of freedom each"""
    matched: NDArray[np.bool_]
    """(P,) whether the estimator used the observation, for a landmark of its identity"""


def prior_innovations(observations: Sequence[Observation], estimate: Estimate, joint: Array) -> PriorInnovations:
    """Those of observations, given an estimate before them and its joint covariance (3 + 2n, 3 + 2n)."""
    squared = np.full((len(observations), len(estimate.ids)), np.inf)
    if squared.size:
        observed, everywhere = Observed.of(observations), np.arange(len(estimate.ids))
        found = compare(observed, np.zeros(len(everywhere)), estimate, everywhere, joint).squared
        squared = np.where(observed.walls[:, None] == estimate.walls[None, :], found, np.inf)
    return PriorInnovations(tuple(observations), estimate.ids, squared)


class InnovationObserver:
    """Keeps the innovations of all observations against all landmarks; it slows a run with many landmarks down."""

    def __init__(self) -> None:
        self.scans: list[PriorInnovations] = []
        """one for each keyframe"""
        self._joint = np.zeros((3, 3))
        """joint covariance after the last keyframe"""

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Observe a run; it is the `on_tick` of `sixthsense.loop.run.run`."""
        k = len(self.scans)
        if len(trace.associations) == k:
            return
        assert trace.live is not None and trace.live.features is not None
        seen, present = trace.live.features.observations, trace.key_predicted[k]
        before, joint = present, self._joint
        if k:  # no landmark has moved since
            last = trace.key_estimates[k - 1]
            before = replace(last, pose=present.pose, pose_cov=present.pose_cov)
            by_pose, _ = compose_jacobians(last.pose.theta, trace.key_odometry[k].motion)
            joint[:3, 3:] = by_pose @ joint[:3, 3:]
            joint[3:, :3] = joint[:3, 3:].T
            joint[:3, :3] = present.pose_cov
        self.scans.append(prior_innovations(seen, before, joint))
        self._joint = trace.live.estimator.joint_covariance(trace.key_estimates[k].ids.tolist())


def true_pair_nis(
    observed: Sequence[PriorInnovations],
    associations: Sequence[Association],
    truths: Array,
    scene: TrueLandmarks,
    laser: TrueLaser,
) -> TruePairs:
    """NIS of each observation with a single identity against the known landmark of that identity.

    `observed`, `associations` and the true poses `truths` (K, 3) are of the same keyframes. Of several landmarks with
    the identity the oldest is taken, which does not depend on the innovations. An observation without such a landmark
    has no pair.
    """
    identities: dict[LandmarkId, Identity] = {}
    nis: list[float] = []
    matched: list[bool] = []
    for scan, association, truth in zip(observed, associations, truths, strict=True):
        pose = Pose.from_array(truth)
        for j, seen in enumerate(identify(scan.observations, pose, scene, laser)):
            of_it = [k for k, i in enumerate(scan.ids.tolist()) if i in identities and identities[i] == seen.identity]
            if of_it:
                nis.append(float(scan.squared[j, min(of_it, key=lambda k: int(scan.ids[k]))]))
                matched.append(_is_used(scan.observations[j], association, identities, seen.identity))
        accepted = association.observations
        for i, one in zip(accepted, identify(list(accepted.values()), pose, scene, laser), strict=True):
            if one.identity is not None:
                identities.setdefault(i, one.identity)
    return TruePairs(np.array(nis), np.array(matched, dtype=bool))


def _is_used(
    observation: Observation,
    association: Association,
    identities: dict[LandmarkId, Identity],
    identity: Identity | None,
) -> bool:
    """Whether an observation, or one that it was fused into, was matched with a known landmark of the identity.

    A return is part of one observation only, so its bearing tells which.
    """
    return any(
        identities.get(i) == identity and bool(np.isin(observation.bearings[0], other.bearings))
        for i, other in association.observations.items()
    )
