"""The map of an exploration: where the robot may drive, and the part to be seen, within the driving limits."""

from __future__ import annotations

from dataclasses import replace

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.driving_limits import UNKNOWN_M, Widening
from sixthsense.navigation.gridsearch import FarCells
from sixthsense.navigation.map_window import MapWindow, Region
from sixthsense.navigation.path_margin import margin_m
from sixthsense.navigation.path_planner import DrivingMap
from sixthsense.navigation.ways import Ways
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid


class LimitedMap:
    """Draws maps within the limits of one exploration."""

    def __init__(self, region: Region, radius_m: float, config: Config) -> None:
        """Begin with the narrowest limits around a region, and no open way."""
        self.widening = Widening(region, config.explore.margin_m, config.laser.max_range)
        self.ways = Ways(radius_m, config)
        self._region, self._config = region, config
        self._far_cells = FarCells(round(UNKNOWN_M / config.grid.cell_m))

    def driving_map(self, grid: Grid, estimate: Estimate) -> DrivingMap:
        """Where the robot may drive."""

        def free_space(margin_m: float, places: Array, within: Ellipse | None) -> FreeSpace:
            space = grid.free_space(*places, margin_m=margin_m, within=within)
            blocked = self.widening.limits.blocked(space, self._far_cells, grid.changes)
            if margin_m == 0.0:
                self.ways.unblock(blocked, space, grid)
            blocked.flags.writeable = False
            return replace(space, blocked=blocked)

        return DrivingMap(grid, free_space, margin_m(estimate.pose_cov, self._config))

    def window(self, grid: Grid, space: FreeSpace) -> MapWindow:
        """The part of a grid to be seen, and of the free space made from it."""
        return MapWindow.of(grid, space, self.widening.limits.rows_and_cols(space), self._region)
