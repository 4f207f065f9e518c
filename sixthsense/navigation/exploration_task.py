"""What an exploration is asked to do, by what means, and how far outside of its region the robot may drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.path_planner import PathPlanner
from sixthsense.navigation.regions import spread
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import TOUCH, Bools

Region = tuple[float, float, float, float]
"""x0, y0, x1, y1, world frame, metres."""
Counts = NDArray[np.uint8]
"""(H, W) from how many viewpoints chosen for it each cell was not seen."""

TRIES = 2
"""a target that was not seen from this many viewpoints, with a full turn at each, is given up: one may mislead"""


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationTask:
    """What to explore, and by what means."""

    home: Array
    """(2,) where the robot starts and returns to"""
    region: Region
    """holds the start"""
    radius_m: float
    """the robot's"""
    paths: PathPlanner
    config: Config
    rng: np.random.Generator
    """for the explorer"""


class AreaToSee:
    """A region with what may be visible only across its edge."""

    def __init__(self, region: Region, config: Config) -> None:
        """Begin with a robot that drives no farther outside the region than the configured margin."""
        cell_m, laser_m, explore = config.grid.cell_m, config.laser.max_range, config.explore
        self.is_wide = False
        """whether the robot may drive, and unknown cells count, as far outside the region as its laser reaches"""
        self._region = cells_within(region, cell_m, -0.5 * cell_m)
        self._limits = {
            False: cells_within(region, cell_m, explore.margin_m),
            True: cells_within(region, cell_m, max(explore.margin_m, laser_m)),
        }
        near_m = 0.5 * explore.margin_m  # outside the region, unknown cells count that lie so near to unseen ones of it
        self._outside = {False: max(1, round(near_m / cell_m)), True: round(laser_m / cell_m)}

    @property
    def limits(self) -> Box:
        """The cells that the robot may drive in."""
        return self._limits[self.is_wide]

    @property
    def narrow_outside(self) -> int:
        """Cells outside the region within which unknown ones count for a robot that does not leave it."""
        return self._outside[False]

    def of_region(self, mask: Bools, box: Box) -> Bools:
        """(H, W) the cells of `mask`, of a box, that are of the region."""
        part, of_region = self._region.within((box.top, box.left), mask.shape), np.zeros_like(mask)
        of_region[part] = mask[part]
        return of_region

    def given_up(self, attempts: Counts) -> Bools:
        """(H, W) the cells that were not seen from as many viewpoints as are tried."""
        return np.asarray(attempts >= TRIES)

    def to_see(self, unknown: Bools, box: Box, attempts: Counts) -> Bools:
        """(H, W) the unknown cells of a box that are to be seen: those of the region, and some beside it.

        For a part of the region may be visible only across its edge. Cells that were looked at and not seen are no
        reason to drive far outside.
        """
        few = ~self.given_up(attempts)
        wanted, inside = self.of_region(unknown, box), self._region.within((box.top, box.left), unknown.shape)
        bounds = inside[0].start, inside[0].stop, inside[1].start, inside[1].stop
        if self.is_wide:
            wanted, bounds = wanted & few, (0, 0, 0, 0)
        return spread(wanted, unknown, self._outside[self.is_wide], bounds) & few


def cells_within(region: Region, cell_m: float, margin_m: float) -> Box:
    """The cells that a region and a margin around it touch."""
    x0, y0, x1, y1 = region
    top, left = (math.floor((low - margin_m) / cell_m + TOUCH) for low in (y0, x0))
    bottom, right = (math.ceil((high + margin_m) / cell_m - TOUCH) for high in (y1, x1))
    return Box(top, left, max(bottom, top), max(right, left))
