"""How well returns fit the obstacles of a map, and at which pose they fit best."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.slam.mapping.evidence import are_obstacles
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.submap import Submap

NEAR_M = 0.15
"""a return this near an obstacle is explained by it"""
_FAR_M = 0.3  # a return in free space this far from all obstacles contradicts the map
_FLAT_M = 1.0  # farther obstacles attract no return
_SMOOTH_CELLS, _WEIGHT = 2.0, 0.3  # of the distances: single cells must not tell a place along a wall
_SCALE_M, _STEPS = 0.05, 12


class Obstacles(NamedTuple):
    """Cells of a map, (H, W)."""

    distance_m: Array
    """from each cell to the nearest obstacle"""
    seen: Bools
    by_x: Array
    """slope of the smoothed distance"""
    by_y: Array
    corner: Array
    """(2,) x, y of the corner of cell (0, 0)"""
    cell_m: float

    @classmethod
    def of(cls, evidence: Submap, config: GridConfig) -> Obstacles:
        """Those of a map with cells as `config` says, with a metre of unknown cells around them."""
        rim = round(1.0 / config.cell_m)
        low, high = np.array(evidence.box.corners) - np.array([[rim], [-rim]])
        shape = tuple((high - low + 1).tolist())
        rows, cols = (evidence.cells - low).T
        occupied, seen = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        occupied[rows, cols] = are_obstacles(evidence.hits, evidence.passes, config)
        seen[rows, cols] = evidence.seen
        distance = distance_transform_edt(~occupied) if occupied.any() else np.full(shape, np.inf)
        distance = distance * config.cell_m
        by_y, by_x = np.gradient(gaussian_filter(np.minimum(distance, _FLAT_M), _SMOOTH_CELLS), config.cell_m)
        return cls(distance, seen, by_x, by_y, low[::-1] * config.cell_m, config.cell_m)

    @property
    def centres(self) -> Array:
        """(N, 2) centres of the obstacles' cells."""
        rows, cols = np.nonzero(self.distance_m == 0.0)
        return (np.column_stack([cols, rows]) + 0.5) * self.cell_m + self.corner

    def at(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Bools]:
        """Row and column of points (..., 2), clipped, and which are inside."""
        cells = np.floor((points - self.corner) / self.cell_m).astype(np.int64)
        inside = ((cells >= 0) & (cells < self.distance_m.shape[::-1])).all(axis=-1)
        cells = np.clip(cells, 0, np.array(self.distance_m.shape[::-1]) - 1)
        return cells[..., 1], cells[..., 0], np.asarray(inside)


def judged(ends: Array, laser: Array, obstacles: Obstacles) -> tuple[int, int]:
    """How many returns, at `ends` (N, 2) of beams from `laser` (2,), the map explains, and how many it contradicts.

    What ends in unknown space says nothing, unless an obstacle was in the way.
    """
    row, col, inside = obstacles.at(ends)
    distance = np.where(inside, obstacles.distance_m[row, col], np.inf)
    explained = distance <= NEAR_M
    contradicted = inside & obstacles.seen[row, col] & (distance > _FAR_M)
    rest = np.flatnonzero(~explained & ~contradicted)
    beams = ends[rest] - laser
    reach = np.hypot(beams[:, 0], beams[:, 1])
    step = 0.5 * obstacles.cell_m
    along = step * np.arange(int(reach.max(initial=0.0) / step) + 1)
    row, col, inside = obstacles.at(laser + along[:, None, None] * (beams / np.maximum(reach, step)[:, None]))
    blocked = inside & (obstacles.distance_m[row, col] == 0.0) & (along[:, None] < reach - _FAR_M)
    return int(explained.sum()), int(contradicted.sum() + blocked.any(axis=0).sum())


def fitted(points: Array, at: Pose, obstacles: Obstacles, pose: Pose, information: Array) -> Pose:
    """The pose at which points (N, 2) fit best, by Gauss-Newton from `at` on their distances from obstacles.

    The loss is Cauchy's; `pose` is a prior with `information` (3, 3).
    """
    now = at.array()
    for _ in range(_STEPS):
        here = Pose.from_array(now)
        ends = here @ points
        row, col, inside = obstacles.at(ends)
        r = np.where(inside, np.minimum(obstacles.distance_m[row, col], _FLAT_M), _FLAT_M)
        gx, gy = (np.where(inside, slope[row, col], 0.0) for slope in (obstacles.by_x, obstacles.by_y))
        lever = ends - here.position
        J = np.column_stack([gx, gy, gy * lever[:, 0] - gx * lever[:, 1]])
        weighted = _WEIGHT * J / (_SCALE_M**2 + r**2)[:, None]
        off = now - pose.array()
        off[2] = wrap_angle(float(off[2]))
        now = now - np.linalg.solve(information + weighted.T @ J, information @ off + weighted.T @ r)
    return Pose.from_array(now)
