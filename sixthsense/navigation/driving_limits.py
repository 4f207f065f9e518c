"""Where an exploring robot may drive: within a margin around its region."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import FarCells
from sixthsense.navigation.map_window import Region
from sixthsense.slam.mapping.changes import Changes
from sixthsense.slam.mapping.freespace import TOUCH, Bools, FreeSpace

UNKNOWN_M = 0.2
"""Unknown cells farther than this from all that was seen are no way."""

_OUTSIDE_M = 0.5, 2.0, 5.0, math.inf  # margins outside the region, in turn, when nothing else is left to see


@dataclass(frozen=True, slots=True)
class DrivingLimits:
    """A rectangle that the robot's centre must not leave, and the cells in it near what was seen."""

    region: Region
    """the region to be explored"""
    margin_m: float
    """how far outside it the robot may drive"""

    def rows_and_cols(self, space: FreeSpace) -> tuple[slice, slice]:
        """Rows and columns of a space within the limits."""
        (x0, y0, x1, y1), margin = self.region, self.margin_m
        slices = []
        for low, high, origin, count in (
            (y0, y1, space.origin[1], space.blocked.shape[0]),
            (x0, x1, space.origin[0], space.blocked.shape[1]),
        ):
            first = math.floor((low - margin - origin) / space.cell_m + TOUCH)
            past = math.ceil((high + margin - origin) / space.cell_m - TOUCH)
            slices.append(slice(min(max(first, 0), count), min(max(past, 0), count)))
        return slices[0], slices[1]

    def blocked(self, space: FreeSpace, far_cells: FarCells, changes: Changes) -> Bools:
        """(H, W) the blocked cells of a space, all cells outside the limits, and those far into the unknown.

        `far_cells` tells those farther than `UNKNOWN_M` from all that was seen; `changes` are those of the map.
        """
        inside = rows, cols = self.rows_and_cols(space)
        blocked = np.empty(space.blocked.shape, dtype=np.bool_)
        blocked[: rows.start], blocked[rows.stop :] = True, True
        blocked[rows, : cols.start], blocked[rows, cols.stop :] = True, True
        first = round(space.origin[1] / space.cell_m) + rows.start, round(space.origin[0] / space.cell_m) + cols.start
        far = far_cells.of(space.seen[inside], first, changes)
        np.logical_or(space.blocked[inside], far, out=blocked[inside])
        return blocked


@dataclass(slots=True)
class Widening:
    """How far outside the region unknown cells count; a robot that needs to may drive as far, too."""

    region: Region
    """the region to be explored"""
    margin_m: float
    """how far outside it any robot may drive"""
    laser_m: float
    """range of the laser, beyond which nothing is seen from the region"""
    step: int = 0
    """0: no farther than any robot"""

    @property
    def is_last(self) -> bool:
        """Whether there is no wider step."""
        return self.step == len(_OUTSIDE_M) - 1

    @property
    def outside_m(self) -> float:
        """Margin outside the region in which unknown cells count."""
        return min(_OUTSIDE_M[self.step], self.laser_m)

    @property
    def limits(self) -> DrivingLimits:
        """Where the robot may drive."""
        return DrivingLimits(self.region, max(self.margin_m, self.outside_m) if self.step > 0 else self.margin_m)


def track_cells(positions: Array, origin: tuple[float, float], cell_m: float, shape: tuple[int, int]) -> Bools:
    """(H, W) the cells along a path (N, 2) and their neighbours, of a grid whose first corner is `origin`."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    steps = np.arange(0.0, along[-1] + cell_m, 0.5 * cell_m)
    points = np.column_stack([np.interp(steps, along, positions[:, axis]) for axis in (0, 1)])
    cols, rows = np.floor((points - origin) / cell_m).astype(np.int64).T
    beside = np.arange(-1, 2)
    around = np.clip(rows, 0, shape[0] - 1)[:, None, None] + beside[:, None]
    across = np.clip(cols, 0, shape[1] - 1)[:, None, None] + beside
    track = np.zeros(shape, dtype=np.bool_)
    track[np.clip(around, 0, shape[0] - 1), np.clip(across, 0, shape[1] - 1)] = True
    return track
