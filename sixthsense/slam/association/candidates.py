"""Landmarks on probation: sightings that fit no landmark, until there are enough of them to be of one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Sighting, initialize_landmark
from sixthsense.slam.association.walls import ends, in_line


@dataclass(slots=True, eq=False)
class _Candidate:
    mean: Array  # (2,), world frame, as it was last seen: a point's position, or a wall
    extent: Array | None  # (2, 2), world frame, of a wall
    sightings: int
    last_scan: int


class Candidates:
    """Counts sightings of what may become a landmark, scan by scan."""

    def __init__(self, config: AssociationConfig) -> None:
        self._config = config
        self._all: list[_Candidate] = []
        self._scan = 0

    def next_scan(self) -> None:
        """Begin a key scan; what was unseen for too long is dropped."""
        self._scan += 1
        self._all = [c for c in self._all if self._scan - c.last_scan <= self._config.candidate_scans]

    def proves_itself(self, pose: Pose, sighting: Sighting) -> bool:
        """Count a sighting from `pose` that fits no landmark; True when its candidate has been seen often enough."""
        needed = self._config.candidate_sightings
        if needed == 1:
            return True
        mean, _, _ = initialize_landmark(pose, sighting)
        extent = ends(pose, sighting) if sighting.is_wall else None
        for candidate in self._all:
            if not self._is_of(candidate, mean, extent):
                continue
            if candidate.last_scan == self._scan:
                return False  # two sightings of one scan are not two of one landmark
            candidate.mean, candidate.extent = mean, extent
            candidate.sightings += 1
            candidate.last_scan = self._scan
            if candidate.sightings >= needed:
                self._all.remove(candidate)
                return True
            return False
        self._all.append(_Candidate(mean, extent, 1, self._scan))
        return False

    def _is_of(self, candidate: _Candidate, mean: Array, extent: Array | None) -> bool:
        if candidate.extent is None or extent is None:
            both_points = candidate.extent is extent
            return both_points and math.dist(candidate.mean, mean) < self._config.candidate_gate_m
        walls, extents = np.array([candidate.mean, mean]), np.array([candidate.extent, extent])
        first = np.array([True, False])
        return bool(in_line(walls, extents, first, self._config.wall_gap_m, self._config.candidate_gate_m))
