"""Observations in a factor graph, with the places of their factors, and their residuals at the solution."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation, observation_innovations
from sixthsense.slam.estimators.isam2_factors import Loss, noise_of, with_loss

_FIELDS = (("pose", np.int64), ("id", np.int64), ("place", np.int64), ("wall", np.bool_), ("first", np.bool_),
           ("z", np.float64, (2,)), ("cov", np.float64, (2, 2)))  # fmt: skip


NO_POSE = -1
"""of the factor between a wall and what is seen of it"""


def point_factor(point: int, pose: int, observation: Observation, loss: Loss | None) -> gtsam.NonlinearFactor:
    """The observation of a point as a factor between the variables with these keys."""
    bearing, distance, cov = observation.bearing_range()
    return gtsam.BearingRangeFactor2D(pose, point, gtsam.Rot2(bearing), distance, with_loss(noise_of(cov), loss))


class FactorOf(NamedTuple):
    """What a factor of an observation is of."""

    pose: int
    """index of the pose that it was observed from, or `NO_POSE`"""
    landmark: LandmarkId
    observation: Observation
    is_first: bool
    """whether it fixes the landmark: it stays where others contradict it"""


class ObservationFactors:
    """Observations by the place of their factors in the graph."""

    def __init__(self) -> None:
        self._rows = np.zeros(256, dtype=list(_FIELDS))
        self._count = 0

    def add(self, factor: FactorOf, place: int) -> None:
        """Add an observation whose factor has that place in the graph."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        pose, i, seen, is_first = factor
        self._rows[self._count] = (pose, i, place, seen.is_wall, is_first, seen.z, seen.cov)
        self._count += 1

    def places(self, ids: Collection[LandmarkId]) -> list[int]:
        """Places of the factors of these landmarks, ascending."""
        rows = self._rows[: self._count]
        return sorted(rows["place"][np.isin(rows["id"], list(ids))].tolist())

    def drop_poses(self, poses: Sequence[int]) -> list[int]:
        """Remove the observations from some poses; the places of their factors."""
        if not poses:
            return []
        rows = self._rows[: self._count]
        places: list[int] = rows["place"][np.isin(rows["pose"], poses)].tolist()
        self.drop(places)
        return places

    def drop(self, places: Collection[int]) -> None:
        """Remove the observations whose factors have these places."""
        rows = self._rows[: self._count]
        kept = rows[~np.isin(rows["place"], list(places))]
        self._rows[: len(kept)] = kept
        self._count = len(kept)

    def renumber(self, before: Sequence[int], after: Sequence[int]) -> None:
        """Renumber the factors: those at the places `before`, ascending, are now at `after`."""
        place = self._rows["place"][: self._count]
        place[:] = np.asarray(after)[np.searchsorted(before, place)]

    def squared_residuals(self, poses: Array, ids: NDArray[np.int64], landmarks: Array) -> tuple[Array, Array]:
        """Squared Mahalanobis distances of all but each landmark's first observation, and the places of their factors.

        `poses` (K, 3) world frame; `landmarks` (n, 2) are those of `ids` (n,).
        """
        rows = self._rows[: self._count]
        rows = rows[~rows["first"]]
        pose = poses[rows["pose"]]
        order = np.argsort(ids)
        landmark = landmarks[order[np.searchsorted(ids, rows["id"], sorter=order)]]
        z, cov, is_wall = (np.ascontiguousarray(rows[name]) for name in ("z", "cov", "wall"))
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        gap = landmark - pose[:, :2]
        points = np.column_stack([c * gap[:, 0] + s * gap[:, 1], -s * gap[:, 0] + c * gap[:, 1]])
        foot = np.cos(landmark[:, 0]) * pose[:, 0] + np.sin(landmark[:, 0]) * pose[:, 1]
        walls = np.column_stack([wrap_angle(landmark[:, 0] - pose[:, 2]), landmark[:, 1] - foot])
        off, cov = observation_innovations(z, cov, np.where(is_wall[:, None], walls, points), is_wall)
        return np.einsum("ni,ni->n", off, np.linalg.solve(cov, off[:, :, None])[:, :, 0]), rows["place"]
