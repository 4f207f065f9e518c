"""The true identity of an observation: which wall or point of the scene the laser sees there; for evaluation only.

The scene and the true pose decide, not the covariance that the observation states. An observation with a large
covariance would otherwise agree with everything.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.landmark_kernels import line_ends
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.evaluation.metrics import true_landmarks

_SAME_RAD, _SAME_M = 1e-4, 1e-3  # tolerances of a segment to lie on a line

_PLACES = 30
"""along an observed wall, each of the true wall that is nearest to it"""
_NEAR_M, _NEAR_POINT_M = 0.1, 0.15
"""within which it is, and a true point of an observed one"""
_LEAST_SHARE = 0.1
"""of the places of an observed wall, on a line that counts: fewer have little weight in the fit, as beside a corner"""

Identity = tuple[str, int]
"""A face of a true line ("front" is the side that its normal points to, or "back") or a true "point"; its index."""


@dataclass(frozen=True, slots=True)
class TrueLandmarks:
    """The distinguishable lines and points of a scene, world frame."""

    lines: Array
    """(L, 2) alpha, d; collinear segments share a line"""
    segments: Array
    """(N, 2, 2) m"""
    line_of: NDArray[np.int64]
    """(N,) index of the line of each segment"""
    points: Array
    """(P, 2) corners and ends of walls, m"""

    def landmark(self, identity: Identity) -> Array:
        """(2,) true parameters of the landmark: alpha, d of a face, normal to the side it is seen from, or x, y."""
        kind, index = identity
        if kind == "point":
            return np.asarray(self.points[index])
        alpha, d = self.lines[index]
        return np.array([alpha, d]) if kind == "front" else np.array([alpha + np.pi, -d])


def true_identities(walls: Array) -> TrueLandmarks:
    """The lines and points of the `walls` (N, 2, 2) of a scene, metres; collinear walls form one line."""
    segments = walls[np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1) > 2.0 * _SAME_M]
    along = segments[:, 1] - segments[:, 0]
    alpha = np.arctan2(along[:, 0], -along[:, 1])
    normals = np.column_stack([np.cos(alpha), np.sin(alpha)])
    d = np.einsum("ij,ij->i", segments[:, 0], normals)
    first = np.arange(len(segments))  # segment of the same line
    for k, segment in enumerate(segments):
        off = np.abs(segment @ normals[:k].T - d[:k])  # (2, k)
        same = (np.abs(np.sin(alpha[k] - alpha[:k])) < _SAME_RAD) & (off.max(axis=0) < _SAME_M)
        first[k] = first[same.argmax()] if same.any() else k
    own, line_of = np.unique(first, return_inverse=True)
    return TrueLandmarks(np.column_stack([alpha, d])[own], segments, line_of, true_landmarks(walls))


def identify(observations: Sequence[Observation], T_world_robot: Pose, scene: TrueLandmarks) -> list[list[Identity]]:
    """What each observation of a scan truly is of, from the true pose of the robot at the scan's stamp.

    A wall: the faces that are nearest to places along it, if a tenth of the places lie on them, in the order of their
    number; more than one if it spans several. A point: the nearest corner or end. Empty for one of nothing in
    the scene. A de-skewed scan is judged at its stamp: the error of the odometry over its sweep is neglected.
    """
    return [(_faces if one.is_wall else _point)(one, T_world_robot, scene) for one in observations]


def landmark_identities(
    associations: Sequence[Mapping[LandmarkId, Observation]], truths: Array, scene: TrueLandmarks
) -> dict[LandmarkId, Identity]:
    """The identity that more than half of a landmark's observations have; without those that have none.

    A line fitted across several pieces of a wall is none of these: to which the first observation belonged does not
    say where the landmark is.
    """
    seen: dict[LandmarkId, list[Identity | None]] = {}
    for observations, truth in zip(associations, truths, strict=True):
        judged = identify(list(observations.values()), Pose.from_array(truth), scene)
        for i, faces in zip(observations, judged, strict=True):
            seen.setdefault(i, []).append(faces[0] if len(faces) == 1 else None)
    identities: dict[LandmarkId, Identity] = {}
    for i, found in seen.items():
        most, count = Counter(found).most_common(1)[0]
        if most is not None and 2 * count > len(found):
            identities[i] = most
    return identities


def _faces(wall: Observation, T_world_robot: Pose, scene: TrueLandmarks) -> list[Identity]:
    first, last = T_world_robot @ np.asarray(line_ends(wall.z, *wall.extent))
    reach_m = 0.5 * float(np.hypot(*(last - first))) + 2.0 * _NEAR_M
    beside = np.flatnonzero(point_segment_distance(0.5 * (first + last), scene.segments) <= reach_m)
    if not len(beside):
        return []
    off = point_segment_distance(np.linspace(first, last, _PLACES)[:, None], scene.segments[beside])  # (places, beside)
    nearest = beside[off.argmin(axis=1)[off.min(axis=1) <= _NEAR_M]]
    lines, count = np.unique(scene.line_of[nearest], return_counts=True)
    order = np.argsort(-count, kind="stable")
    lines = lines[order][count[order] >= _LEAST_SHARE * _PLACES]
    normals = np.column_stack([np.cos(scene.lines[lines, 0]), np.sin(scene.lines[lines, 0])])
    sides = np.where(normals @ T_world_robot.position > scene.lines[lines, 1], "front", "back").tolist()
    return list(zip(sides, lines.tolist(), strict=True))


def _point(point: Observation, T_world_robot: Pose, scene: TrueLandmarks) -> list[Identity]:
    away = np.linalg.norm(scene.points - T_world_robot @ point.z, axis=1)
    return [("point", int(away.argmin()))] if away.min(initial=math.inf) <= _NEAR_POINT_M else []
