"""The true identity of an observation: which walls of the scene its returns hit; for evaluation only.

The returns decide, not the covariance that the observation states. An observation with a large covariance would
otherwise agree with everything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig, LaserNoise
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import Observation
from sixthsense.core.laser import beam_angles
from sixthsense.core.motion import variance
from sixthsense.core.ray_casting import hit_walls
from sixthsense.evaluation.metrics import true_landmarks

_SAME_RAD, _SAME_M = 1e-4, 1e-3  # tolerances of a segment to lie on a line

# A beam beside a corner can hit the neighbouring wall although its return lies near the fitted line, on each side once.
# So one or two foreign returns are no second wall. In a fit to many returns a tenth of them has little weight.
_LEAST_RETURNS, _LEAST_SHARE = 3, 0.1
_SIGMAS = 3.0  # a fit does not distinguish lines that are nearer to each other; likewise the noise of a point
_LEAST_COSINE = 0.02  # of the incidence, as in the fit of a line

Identity = tuple[str, int]
"""A face of a true line ("front" is the side that its normal points to, or "back") or a true "point"; its index."""

Verdict = Literal["single", "spanning", "left out", "unexplained"]


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
        return self.points[identity[1]] if identity[0] == "point" else _face_line(self, identity)


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


@dataclass(frozen=True, slots=True)
class Identified:
    """What an observation truly is of."""

    verdict: Verdict
    """"single": of one line or point; "spanning": of several lines; "left out": of several lines that its fit does not
    distinguish; "unexplained": of nothing in the scene"""
    identity: Identity | None = None
    """of a single one"""
    fit_cov: Array | None = None
    """(2, 2) of a wall's alpha and d, laser's frame: of an ideal fit to its returns"""


UNEXPLAINED = Identified("unexplained")


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
) -> list[Identified]:
    """What each observation of a scan truly is of, from the true pose of the robot at the scan's stamp.

    The beams of the observation's returns are cast through the scene. A line counts if at least 3 returns and at least
    10 % of them hit it. A point is the nearest corner or end of the lines that its returns hit, as far away as the beam
    spacing and the laser's noise allow. A de-skewed scan is judged at its stamp: the error of the odometry over its
    sweep is neglected. An observation without bearings is unexplained.
    """
    T_world_laser = T_world_robot @ Pose(*laser.config.mount)
    counts = [len(observation.bearings) for observation in observations]
    bearings = np.concatenate([np.empty(0), *(observation.bearings for observation in observations)])
    ranges, segment = hit_walls(T_world_laser, bearings, scene.segments, laser.config.max_range)
    angles, reached = bearings + T_world_laser.theta, np.where(segment >= 0, ranges, 0.0)
    hits = T_world_laser.position + reached[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    found = []
    for observation, past, count in zip(observations, np.cumsum(counts, dtype=np.int64).tolist(), counts, strict=True):
        own = past - count + np.flatnonzero(segment[past - count : past] >= 0)
        on = scene.line_of[segment[own]]
        if not len(on):
            found.append(UNEXPLAINED)
        elif observation.is_wall:
            found.append(_identify_wall(hits[own], on, count, T_world_laser, scene, laser))
        else:
            found.append(_identify_point(T_world_robot @ observation.z, on, T_world_laser, scene, laser))
    return found


def distinguished(first: Identity, second: Identity, seen: Identified, position: Array, scene: TrueLandmarks) -> bool:
    """Whether the fit of an observation of a wall, made by a laser at `position` (2,), distinguishes two true walls."""
    if seen.fit_cov is None or "point" in (first[0], second[0]):
        return first != second
    faces = np.array([_face_line(scene, face) for face in (first, second)])
    both, _, _ = predictions((position[0], position[1], 0.0), faces, np.ones(len(faces), dtype=np.bool_))
    off = both[0] - both[1]
    off[0] = wrap_angle(float(off[0]))
    return float(off @ np.linalg.solve(seen.fit_cov, off)) >= _SIGMAS**2


def _face_line(scene: TrueLandmarks, face: Identity) -> Array:
    """(2,) alpha and d of a face, whose normal points to the side that it is seen from."""
    alpha, d = scene.lines[face[1]]
    return np.array([alpha, d]) if face[0] == "front" else np.array([alpha + np.pi, -d])


def _identify_wall(
    hits: Array, on: NDArray[np.int64], count: int, T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> Identified:
    """What a wall with `count` returns is of; of these `hits` (B, 2), world frame, lie on the lines `on` (B,)."""
    lines, returns = np.unique(on, return_counts=True)
    enough = (returns >= _LEAST_RETURNS) & (returns >= _LEAST_SHARE * count)
    lines, returns = lines[enough], returns[enough]
    if not len(lines):
        return UNEXPLAINED
    position = T_world_laser.position
    normals = np.column_stack([np.cos(scene.lines[lines, 0]), np.sin(scene.lines[lines, 0])])
    in_front = normals @ position > scene.lines[lines, 1]
    sides = np.where(in_front, "front", "back").tolist()
    faces: list[Identity] = list(zip(sides, lines.tolist(), strict=True))
    main = faces[int(returns.argmax())]
    single = Identified("single", main, _ideal_fit_cov(hits - position, _face_line(scene, main), laser))
    others = [face for face in faces if face != main]
    if not others:
        return single
    spans = any(distinguished(main, other, single, position, scene) for other in others)
    return Identified("spanning" if spans else "left out")


def _ideal_fit_cov(rays: Array, line: Array, laser: TrueLaser) -> Array:
    """(2, 2) covariance of alpha and d of a line fitted to returns at the ends of `rays` (B, 2), from the laser, m.

    Each return is weighted by the laser's noise across the line.
    """
    range_m, bearing_rad = laser.sigmas
    c, s = math.cos(line[0]), math.sin(line[0])
    cosine = np.maximum(np.abs(rays @ np.array([c, s])) / np.linalg.norm(rays, axis=1), _LEAST_COSINE)
    arms = rays @ np.array([-s, c])
    weights = 1.0 / np.maximum((range_m * cosine) ** 2 + (bearing_rad * arms) ** 2, 1e-18)
    jacobian = np.column_stack([arms, -np.ones(len(arms))])
    return np.asarray(np.linalg.inv(jacobian.T @ (weights[:, None] * jacobian)))


def _identify_point(
    position: Array, on: NDArray[np.int64], T_world_laser: Pose, scene: TrueLandmarks, laser: TrueLaser
) -> Identified:
    """What a point seen at `position` (2,), world frame, is of; its returns hit the lines `on` (B,)."""
    lines = scene.lines[np.unique(on)]
    normals = np.column_stack([np.cos(lines[:, 0]), np.sin(lines[:, 0])])
    candidates = np.flatnonzero((np.abs(scene.points @ normals.T - lines[:, 1]) < 2.0 * _SAME_M).any(axis=1))
    if not len(candidates):
        return UNEXPLAINED
    away = np.linalg.norm(scene.points[candidates] - position, axis=1)
    reach = float(np.linalg.norm(position - T_world_laser.position))
    # The wall of a line that is met flatter is sampled more sparsely.
    cosine = np.maximum(np.abs(normals @ T_world_laser.position - lines[:, 1]) / max(reach, 1e-9), _LEAST_COSINE)
    along = reach / float(cosine.min())
    range_m, bearing_rad = laser.sigmas
    spacing_rad = float(beam_angles(laser.config)[1])
    limit = spacing_rad * along + _SIGMAS * math.hypot(range_m, bearing_rad * along)
    if away.min() > limit:
        return UNEXPLAINED
    return Identified("single", ("point", int(candidates[away.argmin()])))
