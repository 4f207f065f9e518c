"""Travel of a robot that always drives to the nearest frontier, to compare explorations with.

It always knows where it is and what is solid around what it has seen, and drives to the nearest frontier by the
shortest path (Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997), with the same laser's
range, the same clearance and the same coverage, and home at the end. It takes a full scan after every keyframe's
distance and chooses again when it has arrived or seen what it went for.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt
from worlds import occupied

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.evaluation.coverage import visible_area
from sixthsense.navigation.gridsearch import Links, cheapest_path, ways_from
from sixthsense.navigation.visibility import nearest_view, visible_cells
from sixthsense.simulation.mission import mission_of
from sixthsense.simulation.scene import Scene, load_scene

CELL_M = 0.1
Mask = NDArray[np.bool_]
Cell = tuple[int, int]


def nearest_frontier_travel(config: Config, share: float, scene: Scene | None = None) -> float:
    """Length, m, of a way by nearest frontiers that shows a share of the visible area, and home; NaN if none does.

    The scene is that of the configuration, unless it is given.
    """
    scene = scene or load_scene(config.scene, config.map_unknown)
    _, start, _, radius_m, _ = mission_of(config, scene)[1]
    region = config.region or scene.region
    area = visible_area(scene.walls, region, (start.x, start.y), radius_m, config.laser.max_range, CELL_M)
    solid = occupied(scene.walls, np.array(area.origin), area.cell_m, area.mask.shape)
    passable = distance_transform_edt(~solid) * area.cell_m > radius_m + config.grid.clearance_m
    home = int((start.y - area.origin[1]) / area.cell_m), int((start.x - area.origin[0]) / area.cell_m)
    passable[home] = True
    view = _View(area.mask, solid, config.laser.max_range / area.cell_m)
    here, travelled, stride = home, 0.0, config.keyframes.distance_m / area.cell_m
    view.look(here)
    while view.share < share:
        known = passable & (view.seen | ~area.mask)
        known[here] = True
        cost, none = np.ones(known.shape, dtype=np.float32), np.zeros((0, 2), dtype=np.int64)
        goal, wanted = view.nearest(ways_from(Links.of(known, 1), cost, here, none)[0])
        if goal is None:
            return math.nan
        cells, steps = _way(known, here, goal)
        looks = np.unique(np.append(np.searchsorted(steps, np.arange(stride, steps[-1], stride)), len(cells) - 1))
        for k in looks:
            view.look((int(cells[k, 0]), int(cells[k, 1])))
            if view.seen[wanted] or view.share >= share:
                break
        travelled += float(steps[k])
        here = int(cells[k, 0]), int(cells[k, 1])
        if k == len(cells) - 1 and not view.seen[wanted]:
            view.given_up[wanted] = True
    return (travelled + float(_way(passable, here, home)[1][-1])) * area.cell_m


def _way(passable: Mask, here: Cell, goal: Cell) -> tuple[NDArray[np.int64], Array]:
    """The cells (N, 2) of the shortest path, and the lengths (N,) until there, in cells."""
    cells, _, _ = cheapest_path(np.where(passable, 1.0, np.inf).astype(np.float32), here, goal)
    return cells, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(cells, axis=0).T))])


class _View:
    """What has been seen of a known map."""

    def __init__(self, area: Mask, solid: Mask, reach: float) -> None:
        self.seen = np.zeros_like(area)
        self.given_up = np.zeros_like(area)
        """cells that were not seen from where they should be visible"""
        self._area, self._solid, self._reach = np.array(area), solid, reach
        self._cells = max(np.count_nonzero(area), 1)

    @property
    def share(self) -> float:
        return float(np.count_nonzero(self.seen) / self._cells)

    def look(self, cell: Cell) -> None:
        shown = visible_cells(self._solid, self._area & ~self.seen, *cell, self._reach)
        self.seen[tuple(shown.T)] = True

    def nearest(self, ways: NDArray[np.float32]) -> tuple[Cell | None, Cell]:
        """The cell to drive to, and the unseen cell beside seen ones that is visible from there."""
        frontier = np.argwhere(self._area & ~self.seen & ~self.given_up & binary_dilation(self.seen, np.ones((3, 3))))
        reachable = np.isfinite(ways)
        viewpoints = np.where(reachable, np.arange(reachable.size).reshape(reachable.shape), -1)
        away, places = distance_transform_edt(~reachable, return_indices=True)
        if len(frontier):
            rows, cols = frontier.T
            lengths = ways[places[0, rows, cols], places[1, rows, cols]] + away[rows, cols]
            for row, col in frontier[np.argsort(lengths, kind="stable")].tolist():
                found = int(nearest_view(self._solid, viewpoints, 1, row, col, 0.95 * self._reach))
                if found >= 0:
                    return divmod(found, reachable.shape[1]), (row, col)
                self.given_up[row, col] = True
        return None, (0, 0)
