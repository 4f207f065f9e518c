"""Correctness of the data association, judged by the truth.

The true identity of an observation is the wall or point of the scene that its returns hit. The identity of a landmark
is that of its first observation with a single identity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.ray_casting import hit_walls
from sixthsense.evaluation.true_identities import LEAST_COSINE, Identity, TrueLandmarks, TrueLaser, identify

SIGMAS = 3.0  # a fit does not distinguish lines that are nearer to each other
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
    listed: dict[str, list[Match]] = {"wrong": [], "spanning": [], "unexplained": [], "left out": []}
    for k, (observations, truth) in enumerate(zip(associations, truths, strict=True)):
        T_world_laser = Pose.from_array(truth) @ Pose(*laser.config.mount)
        for i, faces in zip(
            observations, identify(list(observations.values()), Pose.from_array(truth), scene, laser), strict=True
        ):
            if not faces:
                listed["unexplained"].append((k, i))
                continue

            def told_apart(first: Identity, second: Identity, one: Observation = observations[i]) -> bool:
                return distinguished(first, second, one, T_world_laser, scene, laser)  # noqa: B023

            if len(faces) > 1:
                spans = any(told_apart(faces[0], other) for other in faces[1:])
                listed["spanning" if spans else "left out"].append((k, i))
                continue
            own = identities.setdefault(i, faces[0])
            if own != faces[0]:
                listed["wrong" if told_apart(faces[0], own) else "left out"].append((k, i))
    count = sum(len(observations) for observations in associations)
    others = (tuple(listed[name]) for name in ("wrong", "spanning", "unexplained", "left out"))
    return Matches(count, *others)


def distinguished(
    first: Identity, second: Identity, seen: Observation, T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> bool:
    """Whether the fit of an observation of the first of two true walls distinguishes it from the second."""
    if "point" in (first[0], second[0]):
        return first != second
    position = T_world_laser.position
    faces = np.array([scene.line(face) for face in (first, second)])
    both, _, _ = predictions((position[0], position[1], 0.0), faces, np.ones(2, dtype=np.bool_))
    off = both[0] - both[1]
    off[0] = wrap_angle(float(off[0]))
    cov = ideal_fit_cov(seen, faces[0], T_world_laser, scene, laser)
    return float(off @ np.linalg.solve(cov, off)) >= SIGMAS**2


def ideal_fit_cov(seen: Observation, line: Array, T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser) -> Array:
    """(2, 2) covariance of alpha and d of a line fitted to an observation's returns, laser's frame.

    Each return is weighted by the laser's noise across the line.
    """
    ranges, segment = hit_walls(T_world_laser, seen.bearings, scene.segments, laser.config.max_range)
    angles, ranges = seen.bearings[segment >= 0] + T_world_laser.theta, ranges[segment >= 0]
    range_m, bearing_rad = laser.sigmas
    cosine = np.maximum(np.abs(np.cos(angles - line[0])), LEAST_COSINE)
    arms = ranges * np.sin(angles - line[0])
    weights = 1.0 / np.maximum((range_m * cosine) ** 2 + (bearing_rad * arms) ** 2, 1e-18)
    jacobian = np.column_stack([arms, -np.ones(len(arms))])
    return np.asarray(np.linalg.inv(jacobian.T @ (weights[:, None] * jacobian)))
