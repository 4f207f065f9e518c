"""The places that an exploration leaves unseen, with the reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array
from sixthsense.navigation.clearance import OPPOSITE
from sixthsense.navigation.frontier import middle_cell
from sixthsense.navigation.gridsearch import Cell, Links, ways_from
from sixthsense.navigation.view_map import ViewMap
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.grid import Grid

Reason = Literal["cut off by inflation only", "unreachable", "gave up"]

_WIDEST = 8.0  # power of 1 / clearance that a way costs: so high that its narrowest gap counts alone


@dataclass(frozen=True, slots=True)
class UnseenPlace:
    """A place that an exploration has left unseen."""

    x: float
    """world frame, metres"""
    y: float
    """world frame, metres"""
    area_m2: float
    """unseen area there that would be visible, according to the map, from the viewpoint that the reason names"""
    reason: Reason
    """gave up: visible from where the robot can drive; it looked and did not see it; cut off by inflation only: beyond
    a gap that is wider than the robot; unreachable: beyond a narrower one, or the robot knows no way there"""
    gap_m: float | None = None
    """how wide the narrowest gap on the widest way there is, metres; None where it can be reached, or where none was
    seen"""


def unseen_places(map_: ViewMap, grid: Grid, radius_m: float, reach: float) -> list[UnseenPlace]:
    """The unseen areas that would be visible from free cells within a `reach`, in cells, the largest first.

    They were given up, or no cell that the robot can drive to has them in view.
    """
    pieces = map_.pieces(map_.known.unseen)
    if not pieces:
        return []
    gaps, hidden = _Gaps(map_, grid), map_.known.unseen.copy()
    found: dict[tuple[Reason, float | None], np.ndarray] = {}
    for piece in pieces:
        kind: tuple[Reason, float | None] = "gave up", None
        viewpoint = map_.view_of(piece, map_.places, reach)
        if viewpoint is None:
            viewpoint = map_.view_of(piece, gaps.anywhere, reach)
            if viewpoint is None:
                continue
            gap_m = gaps.width_m(viewpoint)
            kind = "unreachable" if gap_m is None or gap_m < 2.0 * radius_m else "cut off by inflation only", gap_m
        if not map_.shows_enough(viewpoint, piece, hidden):
            continue
        visible = found.setdefault(kind, np.zeros_like(hidden))
        visible[tuple(visible_cells(map_.obstacles, hidden, *viewpoint, reach).T)] = True
    places = []
    for (reason, gap_m), visible in found.items():
        areas, _ = ndimage.label(visible & hidden)
        hidden &= ~visible
        for k, box in enumerate(ndimage.find_objects(areas), 1):
            cells = np.argwhere(areas[box] == k) + [span.start for span in box]
            area_m2 = len(cells) * map_.cell_m**2
            if area_m2 >= map_.least_m2:
                x, y = map_.points(np.array([middle_cell(cells)]))[0].tolist()
                places.append(UnseenPlace(x, y, area_m2, reason, gap_m))
    return sorted(places, key=lambda place: -place.area_m2)


class _Gaps:
    """How wide the gap is at which the widest way to a place leaves what the robot can drive to."""

    def __init__(self, map_: ViewMap, grid: Grid) -> None:
        self._map, self._grid = map_, grid
        self.anywhere, self._fits = map_.best_cells(map_.free), map_.best_cells(map_.passable) >= 0
        """the best cell of each tile among all free ones, -1 for none; and whether the robot fits into one"""
        self._metres = np.where(self.anywhere >= 0, map_.metres.ravel()[self.anywhere], 0.0)
        cost = np.maximum(self._metres / map_.cell_m, 0.5) ** -_WIDEST
        links, none = Links.of(map_.free, map_.side), np.zeros((0, 2), dtype=np.int64)
        _, self._before = ways_from(links, cost.astype(np.float32), map_.tile(map_.here), none)

    def width_m(self, cell: Cell) -> float | None:
        """The width of the gap to a cell, metres; None without a way, or where one of its sides was not seen."""
        cols, (row, col) = self.anywhere.shape[1], self._map.tile(cell)
        way = [row * cols + col]
        while self._before[way[-1]] >= 0:
            way.append(int(self._before[way[-1]]))
        is_reached = np.flatnonzero(self._map.places.ravel()[way] >= 0)
        if len(is_reached) == 0:
            return None
        beyond = way[: is_reached[0] + 1][::-1]
        ends = np.flatnonzero(self._fits.ravel()[beyond[1:]])
        tiles = beyond[: ends[0] + 2] if len(ends) else beyond
        places = np.stack(np.divmod(self.anywhere.ravel()[tiles], self._map.seen.shape[1]), axis=1)
        between = np.linspace(0.0, 1.0, self._map.side + 1)[:, None, None]
        cells = np.rint(places[:-1] + between * np.diff(places, axis=0)).astype(np.int64).reshape(-1, 2)
        for middle in cells[np.argsort(self._map.metres[tuple(cells.T)], kind="stable")]:
            width_m = self._width_m(self._map.points(middle[None])[0], middle)
            if width_m is not None:
                return width_m
        return None

    def _width_m(self, middle_world: Array, middle: Array) -> float | None:
        """The distance between the nearest obstacle to a place and the nearest opposite one; None without that."""
        row, col = (middle + self._map.first).tolist()
        reach = round(2.0 / self._map.cell_m)
        points = self._grid.obstacle_points(Box(row - reach, col - reach, row + reach, col + reach)) - middle_world
        if len(points) == 0:
            return None
        away = np.linalg.norm(points, axis=1)
        first = int(np.argmin(away))
        opposite = points @ points[first] < -OPPOSITE * away * away[first]
        return float(np.linalg.norm(points[opposite] - points[first], axis=1).min()) if opposite.any() else None
