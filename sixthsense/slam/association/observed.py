"""The observations of a keyframe as arrays, extents of walls, and how near both are to landmarks by geometry.

Extents of walls are in no estimator's state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmark_kernels import innovations_of, line_ends
from sixthsense.core.landmarks import Observation, line_errors, observed_centre
from sixthsense.core.se2 import wrapped
from sixthsense.slam.estimators.base import Estimate

Mask = NDArray[np.bool_]

_PARALLEL_RAD = 0.15
"""between two walls: always plausible below"""
_LANDMARK_M = 0.3
"""sigma of a point that is less certain than its observation"""
WALL_GAP_M = 0.05
"""between what was seen of collinear walls that may be one: narrower than a door, wider than the noise of their ends"""


class Observed(NamedTuple):
    """The m observations of a keyframe, robot's frame."""

    z: Array
    """(m, 2)"""
    cov: Array
    """(m, 2, 2) of z"""
    walls: Mask
    """(m,) which of them are walls"""
    extents: Array
    """(m, 2) first and last place of a wall, as of `Observation`"""
    ends: Array
    """(m, 2, 2) both ends of a wall; twice the position of a point"""

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> Observed:
        """The arrays of some observations."""
        z = np.array([s.z for s in observations]).reshape(-1, 2)
        cov = np.array([s.cov for s in observations]).reshape(-1, 2, 2)
        walls = np.array([s.is_wall for s in observations], dtype=bool)
        extents = np.array([s.extent for s in observations]).reshape(-1, 2)
        lines = [line_ends(s.z, *s.extent) if s.is_wall else np.tile(s.z, (2, 1)) for s in observations]
        return cls(z, cov, walls, extents, np.array(lines).reshape(-1, 2, 2))

    def sigmas_m(self, pose_cov: Array) -> Array:
        """(m,) upper bound of the sigma of a point, or of a wall's middle, in the world; `pose_cov` (3, 3)."""
        of_point, middles = self.cov[:, 0, 0] + self.cov[:, 1, 1], self.ends.mean(axis=1)
        variances = np.where(self.walls, offset_variance(self.cov, self.extents.mean(axis=1)), of_point)
        by_heading = np.hypot(middles[:, 0], middles[:, 1]) * math.sqrt(pose_cov[2, 2])
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)) + by_heading + math.sqrt(np.trace(pose_cov[:2, :2])))


class Distances(NamedTuple):
    """Distances of m observations from n landmarks; those of another kind are infinitely far."""

    metres: Array
    """(m, n) between points; of a wall's middle from a landmark's line"""
    turn_rad: Array
    """(m, n) between walls, at least 0; 0 between points"""
    gap_m: Array
    """(m, n) along the landmark between an observed wall and the known extent; negative where they overlap"""
    length_m: Array
    """(m,) of an observed wall; 0 of a point"""

    @classmethod
    def at(cls, pose: Pose, observed: Observed, estimate: Estimate, extents: Array) -> Distances:
        """Those of observations from the landmarks of an estimate, whose extents are (n, 2, 2), seen from `pose`."""
        alphas = observed.z[:, 0] + pose.theta
        landmarks, walls = estimate.landmarks, estimate.walls
        return cls.between(pose @ observed.ends, alphas, observed.walls, landmarks, walls, extents)

    @classmethod
    def between(
        cls, ends: Array, alphas: Array, is_wall: Mask, landmarks: Array, landmark_is_wall: Mask, extents: Array
    ) -> Distances:
        """Those of observations in the world, `ends` (m, 2, 2) and angles of normals `alphas` (m,), from landmarks."""
        out = np.full((3, len(ends), len(landmarks)), np.inf)
        _distances(ends, alphas, is_wall, landmarks, landmark_is_wall, extents, out)
        return cls(out[0], out[1], out[2], np.hypot(*(ends[:, 1] - ends[:, 0]).T))

    def plausible(self, sigmas: Array, heading_sigma: float, cfg: AssociationConfig) -> Mask:
        """(m, n) pairs that are near enough for a gate on the innovation.

        `sigmas` (m,) of the observations in the world are upper bounds, m; `heading_sigma` of the pose, rad. A landmark
        is assumed to be at least as certain relative to the robot as an observation is in the world, or to 0.3 m.
        """
        widest = math.sqrt(max(cfg.match_gate, cfg.new_gate))
        turn = max(widest * heading_sigma, _PARALLEL_RAD)
        of_walls, of_points = np.maximum(widest * sigmas, cfg.new_separation_m), widest * (sigmas + _LANDMARK_M)
        near = self.metres < np.where(self.length_m > 0.0, of_walls, of_points)[:, None]
        return np.asarray(near & (self.turn_rad < turn) & (self.gap_m < WALL_GAP_M))

    def apart(self, cfg: AssociationConfig) -> Mask:
        """(m, n) pairs that are far enough apart to be of two landmarks, whatever their covariances say."""
        near = (self.metres <= cfg.new_separation_m) & (self.turn_rad < _PARALLEL_RAD)
        return np.asarray(~(near & (self.gap_m < WALL_GAP_M)))


def offset_variance(cov: Array, along: Any) -> Any:
    """Variances of the offsets of walls with `cov` (..., 2, 2) at places `along` them, m from the normal's foot."""
    return cov[..., 1, 1] - 2.0 * along * cov[..., 0, 1] + along * along * cov[..., 0, 0]


@numba.njit(cache=True, error_model="numpy")
def _distances(
    ends: Array, alphas: Array, is_wall: Mask, landmarks: Array, landmark_is_wall: Mask, extents: Array, out: Array
) -> None:
    """Fill `out` (3, m, n) with metres, turn and gap of pairs of one kind; all in the world frame."""
    for j in range(len(landmarks)):
        c, s = math.cos(landmarks[j, 0]), math.sin(landmarks[j, 0])
        first = c * extents[j, 0, 1] - s * extents[j, 0, 0]
        last = c * extents[j, 1, 1] - s * extents[j, 1, 0]
        for i in range(len(ends)):
            if is_wall[i] != landmark_is_wall[j]:
                continue
            if not is_wall[i]:
                out[0, i, j] = math.hypot(ends[i, 0, 0] - landmarks[j, 0], ends[i, 0, 1] - landmarks[j, 1])
                out[1, i, j], out[2, i, j] = 0.0, -math.inf
                continue
            x, y = 0.5 * (ends[i, 0, 0] + ends[i, 1, 0]), 0.5 * (ends[i, 0, 1] + ends[i, 1, 1])
            out[0, i, j] = abs(c * x + s * y - landmarks[j, 1])
            out[1, i, j] = abs(wrapped(alphas[i] - landmarks[j, 0]))
            a, b = c * ends[i, 0, 1] - s * ends[i, 0, 0], c * ends[i, 1, 1] - s * ends[i, 1, 0]
            out[2, i, j] = max(min(a, b), min(first, last)) - min(max(a, b), max(first, last))


_ONE_WALL = np.ones(1, dtype=bool)


def ends(pose: Pose, observation: Observation) -> Array:
    """(2, 2) both ends, in the world, of a wall that is observed from `pose`."""
    return pose @ np.asarray(line_ends(observation.z, *observation.extent))


def disagreement(first: Array, second: Array, cov: Array) -> float:
    """Squared Mahalanobis distance between two walls (2,) in one frame, whose difference has `cov` (2, 2)."""
    (gap,), (about,) = innovations_of(first[None], cov[None], second[None], _ONE_WALL)
    return float(gap @ np.linalg.solve(about, gap))


def joined(landmark: Array, first: Array, second: Array) -> Array:
    """(2, 2) ends, on a landmark (2,), of the smallest extent that covers two extents (2, 2)."""
    places = np.concatenate([first, second]) @ rotation(float(landmark[0]))[:, 1]
    return np.asarray(line_ends(landmark, float(places.min()), float(places.max())))


def fused(first: Observation, second: Observation) -> Observation:
    """One observation of a wall from two pieces of it in the same scan, whose errors are independent."""
    (gap,), (second_cov,) = innovations_of(second.z[None], second.cov[None], first.z[None], _ONE_WALL)
    gain = first.cov @ np.linalg.inv(first.cov + second_cov)
    turn, shift = gain @ gap
    lever, _, _ = line_errors(first.cov)
    alpha = wrap_angle(float(first.z[0]) + turn)
    centre = observed_centre(first)  # it turns about its centre, and is shifted there
    z = np.array([alpha, math.cos(alpha) * centre[0] + math.sin(alpha) * centre[1] + shift - lever * turn])
    cov = first.cov - gain @ first.cov
    extent = min(first.extent[0], second.extent[0]), max(first.extent[1], second.extent[1])
    return Observation(first.kind, z, 0.5 * (cov + cov.T), extent)
