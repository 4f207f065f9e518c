"""Were sightings given to the landmarks that they are of? Associations judged by the truth, for the record only.

What a sighting is of is found from where it truly was taken: its true identity is each line or point of the scene that
explains it. A landmark is what its first explained sighting showed.
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

_SAME_RAD, _SAME_M = 1e-4, 1e-3  # segments this near one line are on it

Identity = tuple[str, int]
"""A face of a true line, "left" or "right" of it, or a true "point", and its number."""


@dataclass(frozen=True, slots=True)
class TrueLandmarks:
    """What a perfect observer could tell apart in a scene, world frame."""

    lines: Array
    """(L, 2) alpha, d: each carries all segments in line with it"""
    segments: Array
    """(N, 2, 2) m"""
    line_of: NDArray[np.int64]
    """(N,) the line of each segment"""
    points: Array
    """(P, 2) corners and ends of walls, m"""


@dataclass(frozen=True, slots=True)
class Matches:
    """How the sightings of a run were matched."""

    sightings: int
    """all that the estimator took in"""
    wrong: tuple[tuple[int, LandmarkId], ...]
    """key scan and landmark of each sighting whose true identity differs from its landmark's"""
    unexplained: tuple[tuple[int, LandmarkId], ...]
    """likewise those that nothing in the scene explains: they are neither right nor wrong"""

    @property
    def wrong_per_1000(self) -> float:
        """Wrong matches among a thousand sightings; 0 without any."""
        return 1e3 * len(self.wrong) / max(self.sightings, 1)

    @property
    def unexplained_per_1000(self) -> float:
        """Unexplained ones among a thousand sightings; 0 without any."""
        return 1e3 * len(self.unexplained) / max(self.sightings, 1)


def true_identities(walls: Array) -> TrueLandmarks:
    """The lines and points of a scene's `walls` (N, 2, 2), metres; walls in line with each other are one line."""
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
    """What in the scene explains a sighting that was taken from the pose `truth`; nothing, one, or (rarely) several.

    A wall is explained by a face of a line that lies within `sigmas` (Mahalanobis distance, by the covariance of the
    sighting) and that has a wall where the sighting saw one; a point by a true point within `sigmas`. What stands on
    both sides of a thin wall is two faces.
    """
    if not sighting.is_wall:
        predicted, _, _ = predict_points(truth, scene.points)
        near = _squared(sighting.z - predicted, sighting.cov) < sigmas**2
        return frozenset(("point", k) for k in np.flatnonzero(near).tolist())
    found: set[Identity] = set()
    # The normal of a sighted wall points to the side it was seen from.
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
    """Whether what was seen, (2, 2) ends, lies at least in part where one of the line's segments (N, 2, 2) does."""
    along = np.array([-np.sin(line[0]), np.cos(line[0])])
    mine, theirs = np.sort(seen @ along), np.sort(segments @ along, axis=1)
    return bool(np.any((mine[0] <= theirs[:, 1]) & (mine[1] >= theirs[:, 0])))


def judge_matches(
    associations: Sequence[Mapping[LandmarkId, Sighting]], truths: Array, scene: TrueLandmarks, sigmas: float = 5.0
) -> Matches:
    """Judge each key scan's sightings, by landmark, that were taken from the true poses `truths` (K, 3).

    A sighting that several things explain narrows down what its landmark may be, and is wrong if nothing is left.
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
