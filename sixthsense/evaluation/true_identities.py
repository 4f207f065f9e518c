"""The true identity of an observation: which wall or point of the scene the laser sees there; for evaluation only.

Rays through the scene decide, not the covariance that the observation states. An observation with a large covariance
would otherwise agree with everything.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig, LaserNoise
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import line_ends
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.laser import beam_angles
from sixthsense.core.motion import variance
from sixthsense.core.ray_casting import hit_walls
from sixthsense.evaluation.metrics import true_landmarks

_SAME_RAD, _SAME_M = 1e-4, 1e-3  # tolerances of a segment to lie on a line

_PLACES = 30
"""along an observed wall, to which rays are cast"""
_NEAR_M = 0.1
"""of the observed line, at most, to the true wall that a ray hits: no other wall has given returns to the fit"""
_LEAST_SHARE = 0.1
"""of the places of an observed wall, on a line that counts: fewer have little weight in the fit, as beside a corner"""
_BESIDE = 5
"""beams on either side of an observed point, which show the walls that it is part of"""
_SIGMAS = 3.0  # of the laser's noise, which a point may be off
LEAST_COSINE = 0.02
"""of the incidence, as in the fit of a line"""

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
        return self.points[identity[1]] if identity[0] == "point" else self.line(identity)

    def line(self, face: Identity) -> Array:
        """(2,) alpha and d of a face, whose normal points to the side that it is seen from."""
        alpha, d = self.lines[face[1]]
        return np.array([alpha, d]) if face[0] == "front" else np.array([alpha + np.pi, -d])


@dataclass(frozen=True, slots=True)
class TrueLaser:
    """What the simulation knows of the laser."""

    config: LaserConfig
    """its beams, range and mount"""
    noise: LaserNoise
    """that the estimator assumes"""

    @property
    def sigmas(self) -> tuple[float, float]:
        """Of a range, m, and of a bearing, rad."""
        both = (variance(self.noise.distribution, scale) for scale in (self.noise.range_m, self.noise.bearing_rad))
        range_var, bearing_var = both
        return math.sqrt(range_var), math.sqrt(bearing_var)


def true_identities(walls: Array) -> TrueLandmarks:
    """The lines and points of the `walls` (N, 2, 2) of a scene, metres; collinear walls form one line."""
    segments = walls[np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1) > 2.0 * _SAME_M]
    lines, count = np.empty((len(segments), 2)), 0
    line_of = np.empty(len(segments), dtype=np.int64)
    for k, segment in enumerate(segments):
        along = segment[1] - segment[0]
        alpha = float(np.arctan2(along[0], -along[1]))
        known = lines[:count]
        off = segment @ np.array([np.cos(known[:, 0]), np.sin(known[:, 0])]) - known[:, 1]  # (2, count)
        same = (np.abs(np.sin(alpha - known[:, 0])) < _SAME_RAD) & (np.abs(off).max(axis=0) < _SAME_M)
        if same.any():
            line_of[k] = int(same.argmax())
        else:
            line_of[k] = count
            lines[count] = alpha, float(segment[0] @ np.array([np.cos(alpha), np.sin(alpha)]))
            count += 1
    return TrueLandmarks(lines[:count].copy(), segments, line_of, true_landmarks(walls))


def identify(
    observations: Sequence[Observation], T_world_robot: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> list[list[Identity]]:
    """What each observation of a scan truly is of, from the true pose of the robot at the scan's stamp.

    A wall: the faces that rays to places along it hit, if a tenth of the places lie on them, in the order of their
    number; more than one if it spans several. A point: the nearest corner or end of the lines that rays beside it hit,
    as far away as the beam spacing and the laser's noise allow. Empty for an observation of nothing in the scene. A
    de-skewed scan is judged at its stamp: the error of the odometry over its sweep is neglected.
    """
    T_world_laser = T_world_robot @ Pose(*laser.config.mount)
    return [
        (_faces if observation.is_wall else _point)(observation, T_world_robot, T_world_laser, scene, laser)
        for observation in observations
    ]


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
        for i, faces in zip(observations, judged, strict=True):
            seen.setdefault(i, []).append(faces[0] if len(faces) == 1 else None)
    identities: dict[LandmarkId, Identity] = {}
    for i, found in seen.items():
        most, count = Counter(found).most_common(1)[0]
        if most is not None and 2 * count > len(found):
            identities[i] = most
    return identities


def _faces(
    wall: Observation, T_world_robot: Pose, T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> list[Identity]:
    first, last = T_world_robot @ np.asarray(line_ends(wall.z, *wall.extent))
    places = np.linspace(first, last, _PLACES)
    seen = T_world_laser.inverse() @ places
    unit = seen / np.linalg.norm(seen, axis=1)[:, None]
    ranges, segment = hit_walls(
        T_world_laser, np.arctan2(unit[:, 1], unit[:, 0]), scene.segments, laser.config.max_range
    )
    hit = segment >= 0
    # Of the places where the rays end, across the observed wall.
    ends = T_world_robot.inverse() @ (T_world_laser @ (ranges[:, None] * unit)[hit])
    is_near = np.abs(ends @ [math.cos(wall.z[0]), math.sin(wall.z[0])] - wall.z[1]) <= _NEAR_M
    lines, count = np.unique(scene.line_of[segment[hit][is_near]], return_counts=True)
    order = np.argsort(-count, kind="stable")
    lines = lines[order][count[order] >= _LEAST_SHARE * _PLACES]
    normals = np.column_stack([np.cos(scene.lines[lines, 0]), np.sin(scene.lines[lines, 0])])
    sides = np.where(normals @ T_world_laser.position > scene.lines[lines, 1], "front", "back").tolist()
    return list(zip(sides, lines.tolist(), strict=True))


def _point(
    point: Observation, T_world_robot: Pose, T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> list[Identity]:
    position = T_world_robot @ point.z
    x, y = T_world_laser.inverse() @ position
    spacing_rad = float(beam_angles(laser.config)[1])
    beside = math.atan2(y, x) + spacing_rad * np.linspace(0.5 - _BESIDE, _BESIDE - 0.5, 2 * _BESIDE)
    _, segment = hit_walls(T_world_laser, beside, scene.segments, laser.config.max_range)
    lines = scene.lines[np.unique(scene.line_of[segment[segment >= 0]])]
    normals = np.column_stack([np.cos(lines[:, 0]), np.sin(lines[:, 0])])
    is_on = np.abs(scene.points @ normals.T - lines[:, 1]) < 2.0 * _SAME_M  # (P, L)
    candidates = np.flatnonzero(is_on.any(axis=1))
    if not len(candidates):
        return []
    away = np.linalg.norm(scene.points[candidates] - position, axis=1)
    own = is_on[candidates[away.argmin()]]
    reach = math.hypot(x, y)
    # The wall of a line that is met flatter is sampled more sparsely.
    cosine = np.abs(normals[own] @ T_world_laser.position - lines[own, 1]) / max(reach, 1e-9)
    along = reach / max(float(cosine.min()), LEAST_COSINE)
    range_m, bearing_rad = laser.sigmas
    limit = spacing_rad * along + _SIGMAS * math.hypot(range_m, bearing_rad * along)
    return [] if away.min() > limit else [("point", int(candidates[away.argmin()]))]
