"""Correctness of the data association, judged by the truth; for evaluation only.

The true identity of an observation is the wall or point of the scene that its returns hit (`true_identities`). The
identity of a landmark is that of its first observation with a single identity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.evaluation.true_identities import Identity, TrueLandmarks, TrueLaser, distinguished, identify
from sixthsense.slam.association.records import Association

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
    """The identity that more than half of a landmark's observations have; without those that have none.

    A line fitted across several pieces of a wall is none of these: to which the first observation belonged does not
    say where the landmark is.
    """
    seen: dict[LandmarkId, list[Identity | None]] = {}
    for observations, truth in zip(associations, truths, strict=True):
        judged = identify(list(observations.values()), Pose.from_array(truth), scene, laser)
        for i, one in zip(observations, judged, strict=True):
            seen.setdefault(i, []).append(one.identity)
    identities: dict[LandmarkId, Identity] = {}
    for i, found in seen.items():
        most, count = Counter(found).most_common(1)[0]
        if most is not None and 2 * count > len(found):
            identities[i] = most
    return identities


def discarded_share(associations: Sequence[Association]) -> float:
    """Share of all observations of a run that were neither matched nor taken as new landmarks; 0 without observations.

    The NIS of the matches says nothing of these: a gate that discards what does not fit makes the rest look consistent.
    """
    discarded = sum(association.discarded for association in associations)
    used = sum(len(association.observations) + association.fused for association in associations)
    return discarded / max(discarded + used, 1)
