"""What a view shows: unseen cells, but none through the holes in walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sixthsense.config import LaserConfig
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.viewpoints import Cell, Viewpoints
from sixthsense.navigation.visibility import expected_gain, gapless_reach
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import too_near

_GAIN_DEPTH_M = 3.0  # how far into unknown space a view is expected to reach
_NEARBY_M = 1.0  # from unseen cells: how far off a view past the edge of an obstacle is completed


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What the choice of a view assumes about the laser."""

    rays: int
    """cast around a viewpoint to estimate its gain: every second beam"""
    reach: float
    """range within which a cell is seen, in cells"""
    gapless_reach: float
    """range within which no cell falls between two beams, in cells"""
    turn_rad: float
    """turn at a viewpoint that covers all directions, and the gaps between beams"""

    @classmethod
    def of(cls, laser: LaserConfig, cell_m: float, keyframe_turn_rad: float) -> SensorModel:
        """The model of a laser; a turn of `keyframe_turn_rad` makes a keyframe."""
        bearings = beam_bearings(laser)
        spacing = abs(float(bearings[1] - bearings[0]))
        return cls(
            rays=max(8, round(math.pi / spacing)),
            reach=0.95 * laser.max_range / cell_m,
            gapless_reach=max(2.0, gapless_reach(spacing, laser.max_range / cell_m)),
            turn_rad=2.0 * math.pi if laser.fov < 2.0 * math.pi - spacing else 3.0 * keyframe_turn_rad + 0.1,
        )


@dataclass(frozen=True, slots=True)
class ViewGain:
    """What would be visible in a map.

    Walls that are far off, or seen at a grazing angle, have holes in the map, and their insides are unseen. So a view
    shows what lines of sight reach that pass no opaque cell.
    """

    view: MapView
    sensor: SensorModel

    def shown(self, wanted: Bools, view: Cell, cell: Cell) -> int:
        """How many of the `wanted` cells (H, W) a view, from one cell of another, shows up to a little behind that."""
        depth, sensor = round(_GAIN_DEPTH_M / self.view.cell_m), self.sensor
        reach = min(sensor.reach, math.dist(view, cell) + depth)
        return int(expected_gain(self.view.opaque, wanted, *view, sensor.rays, reach, depth))

    def span(self, view: Cell, cell: Cell) -> int:
        """How many rows and columns around a cell determine its nearest view and what that shows."""
        around = (_NEARBY_M + _GAIN_DEPTH_M) / self.view.cell_m + self.view.radius
        return math.ceil(2.0 * math.dist(view, cell) + around)

    def shown_nearby(self, wanted: Bools, cell: Cell) -> int:
        """How many of the `wanted` cells the nearest view of a cell shows, if the robot needs no clearance."""
        radius, span = self.view.radius, _NEARBY_M / self.view.cell_m
        around = math.ceil(span + radius)
        top, left = (max(k - around, 0) for k in cell)
        part = slice(top, cell[0] + around + 1), slice(left, cell[1] + around + 1)
        obstacles = self.view.obstacles[part].copy()  # contiguous, as the kernels' arrays are
        fitting = self.view.seen[part] & ~too_near(obstacles, radius)
        view = Viewpoints(fitting, obstacles, span).nearest((cell[0] - top, cell[1] - left))
        return 0 if view is None else self.shown(wanted, (view[0] + top, view[1] + left), cell)
