"""Correctness of the data association, judged by the truth; for evaluation only.

The true identity of a sighting is the set of lines or points of the scene that explain it from the robot's true pose.
The identity of a landmark is that of its first explained sighting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Sighting, innovations, predict_points, predict_walls
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.slam.association.wall_extents import ends

_SAME_RAD, _SAME_M = 1e-4, 1e-3  # tolerances of a segment to lie on a line

Identity = tuple[str, int]
"""A face of a true line ("left" or "right") or a true "point", with its index."""


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


@dataclass(frozen=True, slots=True)
class Matches:
    """Counts of correct, wrong and unexplained matches of a run."""

    sightings: int
    """number of sightings used by the estimator"""
    wrong: tuple[tuple[int, LandmarkId], ...]
    """key scan and landmark of each sighting whose true identity differs from its landmark's"""
    unexplained: tuple[tuple[int, LandmarkId], ...]
    """likewise for sightings that nothing in the scene explains, neither correct nor wrong"""

    @property
    def wrong_per_1000(self) -> float:
        """Wrong matches per thousand sightings; 0 without sightings."""
        return 1e3 * len(self.wrong) / max(self.sightings, 1)

    @property
    def unexplained_per_1000(self) -> float:
        """Unexplained matches per thousand sightings; 0 without sightings."""
        return 1e3 * len(self.unexplained) / max(self.sightings, 1)


def true_identities(walls: Array) -> TrueLandmarks:
    """The lines and points of the `walls` (N, 2, 2) of a scene, metres; collinear walls form one line."""
    segments = walls[np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1) > 2.0 * _SAME_M]
    lines: list[Array] = []
    line_of = np.empty(len(segments), dtype=np.int64)
    for k, segment in enumerate(segments):
        along = segment[1] - segment[0]
        alpha = float(np.arctan2(along[0], -along[1]))
        for j, line in enumerate(lines):
            off = segment @ np.array([np.cos(line[0]), np.sin(line[0])]) - line[1]
            if abs(np.sin(alpha - line[0])) < _SAME_RAD and np.abs(off).max() < _SAME_M:
                line_of[k] = j
                break
        else:
            line_of[k] = len(lines)
            lines.append(np.array([alpha, float(segment[0] @ np.array([np.cos(alpha), np.sin(alpha)]))]))
    return TrueLandmarks(np.array(lines).reshape(-1, 2), segments, line_of, true_landmarks(walls))


def explained_by(sighting: Sighting, truth: Pose, scene: TrueLandmarks, sigmas: float = 5.0) -> frozenset[Identity]:
    """The identities that explain a sighting from the true pose `truth`: none, one, or (rarely) several.

    A point is explained by a true point within `sigmas` (Mahalanobis distance by the covariance of the sighting). A
    wall is explained by a face of a line within `sigmas` that has a wall segment where the sighting saw one. A thin
    wall has two faces.
    """
    if not sighting.is_wall:
        predicted, _, _ = predict_points(truth, scene.points)
        near = _squared(sighting.z - predicted, sighting.cov) < sigmas**2
        return frozenset(("point", k) for k in np.flatnonzero(near).tolist())
    found: set[Identity] = set()
    # The normal of a sighted wall points to the side of the observer.
    for face, turn, sign in (("left", 0.0, 1.0), ("right", np.pi, -1.0)):
        lines = np.column_stack([wrap_angle(scene.lines[:, 0] + turn), sign * scene.lines[:, 1]])
        predicted, _, _ = predict_walls(truth, lines)
        off = innovations(sighting.z, predicted, np.ones(len(lines), dtype=bool))
        for k in np.flatnonzero(_squared(off, sighting.cov) < sigmas**2).tolist():
            if _overlaps(ends(truth, sighting), scene.lines[k], scene.segments[scene.line_of == k]):
                found.add((face, k))
    return frozenset(found)


def _squared(off: Array, cov: Array) -> Array:
    """(K,) squared Mahalanobis distances of (K, 2)."""
    return np.asarray(np.einsum("ki,ij,kj->k", off, np.linalg.inv(cov), off))


def _overlaps(seen: Array, line: Array, segments: Array) -> bool:
    """Whether a sighted wall with ends (2, 2) overlaps one of the line's segments (N, 2, 2) along the line."""
    along = np.array([-np.sin(line[0]), np.cos(line[0])])
    sighted, true = np.sort(seen @ along), np.sort(segments @ along, axis=1)
    return bool(np.any((sighted[0] <= true[:, 1]) & (sighted[1] >= true[:, 0])))


def judge_matches(
    associations: Sequence[Mapping[LandmarkId, Sighting]], truths: Array, scene: TrueLandmarks, sigmas: float = 5.0
) -> Matches:
    """Judge the sightings of each key scan, by landmark, given the true poses `truths` (K, 3).

    The identities of a landmark are intersected with those of each sighting; a sighting is wrong if none remains.
    """
    identity: dict[LandmarkId, frozenset[Identity]] = {}
    count = 0
    wrong: list[tuple[int, LandmarkId]] = []
    unexplained: list[tuple[int, LandmarkId]] = []
    for k, (sightings, truth) in enumerate(zip(associations, truths, strict=True)):
        pose = Pose.from_array(truth)
        for i, sighting in sightings.items():
            count += 1
            seen = explained_by(sighting, pose, scene, sigmas)
            both = identity.get(i, seen) & seen
            if not seen:
                unexplained.append((k, i))
            elif both:
                identity[i] = both
            else:
                wrong.append((k, i))
    return Matches(count, tuple(wrong), tuple(unexplained))
