"""What views show, and the views of cells that searches have found, kept while the map around them stays as it is.

A view shows unseen cells, but none through the holes in walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation.gridsearch.reached import TILE
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.viewpoints import Cell, Viewpoints
from sixthsense.navigation.visibility import expected_gain
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import too_near


class View(NamedTuple):
    """What a search for the view of a cell has found."""

    cell: Cell | None
    """the cell to look from, from the world's origin; None if no view from a cell in reach is worth while"""
    shown: int
    """how many cells it shows, counted until there were more than enough"""
    span: int
    """rows and columns around the cell that determine this"""
    enough: float = math.inf
    """cells"""

    def is_known_beyond(self, dust: float) -> bool:
        """Whether it is known if it shows more than `dust` cells."""
        return self.shown <= self.enough or self.shown > dust


class KnownViews:
    """Remembers what searches for views have found: far from the robot little changes between two searches.

    Cells are counted from the world's origin.
    """

    def __init__(self) -> None:
        """Begin without a view."""
        self._views: dict[Cell, View] = {}
        self._ignored: set[Cell] = set()

    def forget(self, changed: Bools, first: Cell) -> None:
        """Forget the views near the tiles (R, C) of a map that have changed; its cell (0, 0) is `first`."""
        if self._views and changed.any():
            count = np.pad(changed.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))  # in the tiles from the corner on
            known = list(self._views)
            cells = np.array(known) - first
            spans = np.array([view.span for view in self._views.values()])[:, None]
            most = np.array(changed.shape)
            (top, left) = np.clip((cells - spans) // TILE, 0, most).T
            (bottom, right) = np.clip((cells + spans) // TILE + 1, 0, most).T
            near = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0
            for k in np.flatnonzero(near).tolist():
                del self._views[known[k]]
        self._ignored.intersection_update(self._views)

    def add(self, cell: Cell, view: View) -> None:
        """Remember what a search in the latest map has found."""
        self._views[cell] = view

    def get(self, cell: Cell) -> View | None:
        """What is remembered of a cell of the latest map."""
        return self._views.get(cell)

    def ignores(self, cell: Cell) -> bool:
        """Whether the view of a cell is ignored."""
        return cell in self._ignored

    @property
    def shown_by_ignored(self) -> int:
        """How many cells the views that are ignored show together."""
        return sum(self._views[cell].shown for cell in self._ignored)

    def worthwhile(self, cells: list[Cell], dust: float) -> list[int]:
        """The indices of the cells whose views are not ignored, of those whose view is remembered.

        The views that show least are ignored while together they show at most `dust` cells, and until the map around
        them changes. Else small views would take turns, and the robot would cross the building for each.
        """
        shown = [self._views[cell].shown for cell in cells]
        spare = dust - self.shown_by_ignored
        kept = []
        for k in sorted(range(len(cells)), key=shown.__getitem__):
            if cells[k] in self._ignored:
                continue
            spare -= shown[k]
            if spare >= 0.0:
                self._ignored.add(cells[k])
            else:
                kept.append(k)
        return kept


PIECE_M = 1.0
"""longer frontiers are split, and a view past the edge of an obstacle is completed from no farther off"""
_GAIN_DEPTH_M = 3.0  # how far into unknown space a view is expected to reach


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
        spacing, reach = abs(float(bearings[1] - bearings[0])), 0.95 * laser.max_range / cell_m
        return cls(
            rays=max(8, round(math.pi / spacing)),
            reach=reach,
            gapless_reach=max(2.0, min(1.0 / spacing, reach)),
            turn_rad=2.0 * math.pi if laser.fov < 2.0 * math.pi - spacing else 4.0 * keyframe_turn_rad,
        )


@dataclass(frozen=True, slots=True)
class ViewGain:
    """What would be visible in a map.

    Walls that are far off, or seen at a grazing angle, have holes in the map, and their insides are unseen. So a view
    shows what lines of sight reach that pass no opaque cell.
    """

    view: MapView
    sensor: SensorModel

    def shown(self, wanted: Bools, view: Cell, cell: Cell, enough: float) -> int:
        """How many of the `wanted` cells (H, W) a view, from one cell of another, shows up to a little behind that.

        It is counted until there are more than `enough`.
        """
        depth, sensor = round(_GAIN_DEPTH_M / self.view.cell_m), self.sensor
        reach = min(sensor.reach, math.dist(view, cell) + depth)
        towards = round(math.atan2(cell[0] - view[0], cell[1] - view[1]) / math.tau * sensor.rays)
        return int(expected_gain(self.view.opaque, wanted, *view, (sensor.rays, towards), reach, depth, enough))

    def span(self, view: Cell, cell: Cell) -> int:
        """How many rows and columns around a cell determine its nearest view and what that shows."""
        around = (PIECE_M + _GAIN_DEPTH_M) / self.view.cell_m + self.view.radius
        return math.ceil(2.0 * math.dist(view, cell) + around)

    def shown_nearby(self, wanted: Bools, cell: Cell, enough: float) -> int:
        """How many of the `wanted` cells the nearest view of a cell shows, if the robot needs no clearance."""
        radius, span = self.view.radius, PIECE_M / self.view.cell_m
        around = math.ceil(span + radius)
        top, left = (max(k - around, 0) for k in cell)
        part = slice(top, cell[0] + around + 1), slice(left, cell[1] + around + 1)
        obstacles = self.view.obstacles[part].copy()  # contiguous, as the kernels' arrays are
        fitting = self.view.seen[part] & ~too_near(obstacles, radius)
        view = Viewpoints(fitting, obstacles, span).nearest((cell[0] - top, cell[1] - left))
        return 0 if view is None else self.shown(wanted, (view[0] + top, view[1] + left), cell, enough)
