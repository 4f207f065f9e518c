"""Choosing the next view: which unseen cells to look at, and from where.

`ViewPlanner` holds one map and one pose and is never changed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.config import Config, LaserConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation.closed_walls import ClosedMap
from sixthsense.navigation.frontier import (
    adjacent_cells,
    centre_cell,
    centre_cells,
    drop_small_regions,
    frontier_clusters,
)
from sixthsense.navigation.gridsearch import Distances, cell_before_gap
from sixthsense.navigation.hidden_cells import HiddenCells
from sixthsense.navigation.map_window import NOWHERE, UNREACHABLE, MapWindow, Target
from sixthsense.navigation.regions import Cells, are_beside, in_large_regions, spread
from sixthsense.navigation.visibility import expected_gain, gapless_reach, nearest_viewpoint
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import stamped

_TILE_M = 1.0  # longer frontiers are split
_GAIN_DEPTH_M = 3.0  # how far into unknown space a view is expected to reach
_GLIMPSED_M2 = 1.0  # free cells that are not connected to the robot's count as a place if they are so many
_FIRST_RADIUS, _LARGER_RADIUS = 20.0, 1.25  # cells; how far the distances to views are searched, step by step
_NEARBY_M = 1.0  # from unseen cells: how far off a view past the edge of an obstacle is completed
_MAX_VIEWS = 24  # so many views are compared, those of the nearest frontiers


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
    def of(cls, laser: LaserConfig, cell_m: float, key_scan_turn_rad: float) -> SensorModel:
        """The model of a laser; a turn of `key_scan_turn_rad` makes a key scan."""
        bearings = beam_bearings(laser)
        spacing = abs(float(bearings[1] - bearings[0]))
        return cls(
            rays=max(8, round(math.pi / spacing)),
            reach=0.95 * laser.max_range / cell_m,
            gapless_reach=max(2.0, gapless_reach(spacing, laser.max_range / cell_m)),
            turn_rad=2.0 * math.pi if laser.fov < 2.0 * math.pi - spacing else 3.0 * key_scan_turn_rad + 0.1,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The unseen cells to look at and the frontiers beside them."""

    wanted: Bools
    """(H, W) unseen cells to be seen"""
    clusters: list[Cells]
    """frontier cells beside them, (N, 2) each, row and col in the window"""


class _View(NamedTuple):
    """A target, and what its utility follows from but for the way."""

    target: Target
    row: int
    """of the viewpoint in the window"""
    col: int
    """likewise"""
    value: float
    """of what is seen from it"""
    turn_s: float
    """time to turn towards it"""
    shown: int
    """cells that it shows on lines of sight that pass no opaque cell"""


def best_view(views: list[_View], distances: Distances, seconds_per_cell: float, overhead_s: float) -> int | None:
    """The index of the view with the largest value per time, the first of several; None without a view.

    Distances are searched only as far as a view could still be better than the best that was reached.
    """
    radius = _FIRST_RADIUS
    while views:
        best, most, others = 0, -math.inf, -math.inf
        for k, view in enumerate(views):
            length = distances.known(view.row, view.col)
            nearest = distances.radius if length is None else length
            utility = view.value / (seconds_per_cell * nearest + view.turn_s + overhead_s)
            if length is None:
                others = max(others, utility)
            elif utility > most:
                best, most = k, utility
        if others < most:
            return best
        distances.search(radius)
        radius *= _LARGER_RADIUS
    return None


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlanner:
    """Chooses the next view from the map and the robot's pose."""

    closed: ClosedMap
    """the map within the driving limits, with closed walls"""
    failed_views: NDArray[np.uint8]
    """(H, W) how often each cell was not seen from a viewpoint chosen for it"""
    pose: Pose
    """the robot's"""
    sigma_m: float
    """largest standard deviation of its position"""
    distances: Distances
    """from the robot over free space, in cells"""
    radius_m: float
    """the robot's"""
    sensor: SensorModel
    config: Config
    hidden: HiddenCells
    """centres of clusters that no reachable cell of this map sees, or beside which there is too little to see"""

    @property
    def window(self) -> MapWindow:
        """The map within the driving limits, with closed walls."""
        return self.closed.window

    def next_target(self, outside_m: float, widened: bool, rng: np.random.Generator) -> Target | None:
        """The best view, by the configured method; else the nearest one from which little is visible, or nothing yet.

        None if nothing is left to see.

        Unknown cells count up to `outside_m` outside the region, for a part of the region may be visible only across
        its edge. `widened` tells that the robot may drive that far outside, too.
        """
        candidates = self.candidates(outside_m, widened)
        if not candidates.clusters:
            return None
        if self.config.explore.method == "random":
            target = self.sample_random(candidates, rng)
        else:
            target = self.best(candidates)
        return target or self.nearest_shown_elsewhere(candidates)

    def candidates(self, outside_m: float, widened: bool) -> Candidates:
        """What may be looked at: unseen cells that were not given up, beside free cells that are not noise."""
        window, explore = self.window, self.config.explore
        few = self.failed_views < explore.tries
        unknown = window.unknown
        # Cells that were looked at and not seen are no reason to drive farther outside.
        sought = window.unseen & (few | (self.failed_views == UNREACHABLE)) if widened else window.unseen
        steps = max(1, round(outside_m / window.cell_m))
        wanted = spread(sought, unknown, steps, NOWHERE if widened else window.inside) & few
        edge = self.closed.edge[are_beside(wanted, self.closed.edge)]
        edge = edge[in_large_regions(window.free, edge, self.glimpsed_cells(), window.cell(self.pose.position))]
        wanted, edge = drop_small_regions(wanted, edge, explore.dust * np.count_nonzero(window.seen))
        return Candidates(wanted, frontier_clusters(edge, self.tile))

    def glimpsed_cells(self) -> int:
        """Fewest free cells of a place that counts though it is not connected to the robot's.

        A room that was seen through a door which the map has closed since, after an error of the pose perhaps, is none
        that nobody need look at.
        """
        cell_m2 = self.window.cell_m**2
        cells = math.ceil(_GLIMPSED_M2 / cell_m2)
        return cells - 1 if (cells - 1) * cell_m2 >= _GLIMPSED_M2 else cells

    def best(self, candidates: Candidates) -> Target | None:
        """The visible target with the largest gain per time; None if all that is visible together is dust."""
        window, explore, robot = self.window, self.config.explore, self.config.robot
        # An uncertain robot prefers near targets.
        seconds_per_cell = (1.0 + self.sigma_m / explore.revisit_sigma_m) * window.cell_m / robot.speed
        here = window.cell(self.pose.position)
        views: list[_View] = []
        away = [math.dist(here, centre) for centre in centre_cells(candidates.clusters).tolist()]
        for k in np.argsort(away, kind="stable").tolist():
            if len(views) == _MAX_VIEWS:
                break
            cells = candidates.clusters[k]
            (row, col), shown = self._view_beside(candidates.wanted, cells)
            if shown == 0:
                continue
            target = self._target(candidates.wanted, cells, (row, col), occluded=False)
            area = max(self._gain(window.obstacles, candidates.wanted, row, col), len(target.cells)) * window.cell_m**2
            ahead = window.point(row, col) - self.pose.position
            turn = abs(wrap_angle(math.atan2(ahead[1], ahead[0]) - self.pose.theta)) if ahead.any() else 0.0
            views.append(_View(target, row, col, area**explore.gain_exponent, turn / robot.turn_rate, shown))
        if len(views) < _MAX_VIEWS and sum(view.shown for view in views) <= explore.dust * np.count_nonzero(
            window.seen
        ):
            return None
        best = best_view(views, self.distances, seconds_per_cell, explore.overhead_s)
        return None if best is None else views[best].target

    def _gain(self, obstacles: Bools, wanted: Bools, row: int, col: int) -> int:
        """How many of the `wanted` cells a view shows."""
        depth = round(_GAIN_DEPTH_M / self.window.cell_m)
        return int(expected_gain(obstacles, wanted, row, col, self.sensor.rays, self.sensor.reach, depth))

    def nearest_view(self, allowed: Bools, cells: Cells, wanted: Bools) -> tuple[int, int] | None:
        """The nearest of the `allowed` cells (H, W) that has a cluster in view; None if it shows little of `wanted`."""
        index = nearest_viewpoint(allowed, self.window.obstacles, *centre_cell(cells), self.sensor.reach)
        if index < 0:
            return None
        row, col = divmod(int(index), allowed.shape[1])
        return (row, col) if self._shown(wanted, row, col) > 0 else None

    def _shown(self, wanted: Bools, row: int, col: int) -> int:
        """How many of the `wanted` cells lines of sight show that pass no opaque cell; 0 if too few for a view.

        Walls that are far off, or seen at a grazing angle, have holes in the map, and their insides are unseen.
        """
        shown = self._gain(self.closed.opaque, wanted, row, col)
        return shown if shown * self.window.cell_m**2 >= self.config.explore.least_area_m2 else 0

    def sample_random(self, candidates: Candidates, rng: np.random.Generator) -> Target | None:
        """The target nearest to a random cell of the largest unseen area with a visible cluster (the report's idea)."""
        labels, _ = ndimage.label(candidates.wanted)
        sizes = np.bincount(labels.ravel())
        found: dict[int, list[tuple[Cells, Target]]] = {}
        for cells in candidates.clusters:
            target = self.target_beside(candidates.wanted, cells)
            if target is not None:
                row, col = target.cells[0] - self.window.first
                found.setdefault(int(labels[row, col]), []).append((cells, target))
        if not found:
            return None
        label = max(found, key=lambda k: int(sizes[k]))
        area = np.argwhere(labels == label)
        sample = area[rng.integers(len(area))]
        return min(found[label], key=lambda pair: float(((pair[0] - sample) ** 2).sum(axis=1).min()))[1]

    def target_beside(self, wanted: Bools, cells: Cells) -> Target | None:
        """The cells of `wanted` beside a cluster, with the nearest viewpoint; None if no view is worth while."""
        view, shown = self._view_beside(wanted, cells)
        return self._target(wanted, cells, view, occluded=False) if shown > 0 else None

    def _view_beside(self, wanted: Bools, cells: Cells) -> tuple[tuple[int, int], int]:
        """The nearest viewpoint of a cluster, and how many cells it shows; 0 if it is not worth while, or none is.

        A view past the edge of an obstacle, which itself shows too little, counts as one from nearby, where the robot
        would fit without the clearance.
        """
        centre = centre_cell(cells)
        if self.hidden.has(*centre):
            return centre, 0
        index = nearest_viewpoint(self.distances.reachable, self.window.obstacles, *centre, self.sensor.reach)
        view = divmod(int(index), wanted.shape[1])
        shown = (self._shown(wanted, *view) or self._shown_nearby(wanted, centre)) if index >= 0 else 0
        if shown == 0:
            self.hidden.add(*centre)
        return view, shown

    def _shown_nearby(self, wanted: Bools, cell: tuple[int, int]) -> int:
        """How many cells the nearest cell shows where the robot would fit without the clearance; 0 if too few."""
        radius, span = self.radius_m / self.window.cell_m, _NEARBY_M / self.window.cell_m
        around = math.ceil(span + radius)
        top, left = (max(k - around, 0) for k in cell)
        part = slice(top, cell[0] + around + 1), slice(left, cell[1] + around + 1)
        obstacles = self.window.obstacles[part]
        fitting = self.window.seen[part] & ~too_near(obstacles, radius)
        index = nearest_viewpoint(fitting, obstacles, cell[0] - top, cell[1] - left, span)
        row, col = divmod(int(index), fitting.shape[1])
        return self._shown(wanted, row + top, col + left) if index >= 0 else 0

    def nearest_shown_elsewhere(self, candidates: Candidates) -> Target | None:
        """The nearest target of the clusters that only cells out of reach show, though the robot would fit there.

        If a reachable cell has the cluster in view, past the edge of an obstacle perhaps, it is looked at from there,
        else from the last reachable cell before a gap that only the clearance closes, or from as near as possible.
        None if there is no such cluster.
        """
        reachable = self.distances.reachable
        without_clearance = self.distances_without_clearance()
        elsewhere = (self.fitting_cells() | without_clearance.reachable) & ~reachable
        targets = []
        for cells in candidates.clusters:
            if self.target_beside(candidates.wanted, cells) is not None:
                continue  # dust
            if self.nearest_view(elsewhere, cells, candidates.wanted) is None:
                continue
            index = nearest_viewpoint(reachable, self.window.obstacles, *centre_cell(cells), self.sensor.reach)
            view = divmod(int(index), reachable.shape[1]) if index >= 0 else self._nearest_to(cells, without_clearance)
            targets.append(self._target(candidates.wanted, cells, view, occluded=index < 0))
        away = [self.distances.to(*target.viewpoint_in(self.window)) for target in targets]
        return targets[int(np.argmin(away))] if targets else None

    def _nearest_to(self, cells: Cells, without_clearance: Distances) -> tuple[int, int]:
        """The reachable cell before the gap that closes the way to a cluster, else the nearest one."""
        window, reachable, centre = self.window, self.distances.reachable, centre_cell(cells)
        beyond = nearest_viewpoint(without_clearance.reachable, window.obstacles, *centre, self.sensor.reach)
        if beyond >= 0:
            before = cell_before_gap(reachable, without_clearance.to_all(), *divmod(beyond, reachable.shape[1]))
            if before is not None:
                return before
        places = np.argwhere(reachable)
        row, col = places[int(np.argmin(((places - centre) ** 2).sum(axis=1)))].tolist()
        return row, col

    def _target(self, wanted: Bools, cells: Cells, view: tuple[int, int], occluded: bool) -> Target:
        """The cells of `wanted` beside a cluster, to be seen from a cell of the window."""
        first = self.window.first
        return Target(adjacent_cells(wanted, cells) + first, (view[0] + first[0], view[1] + first[1]), occluded)

    def visible_again(self) -> Bools:
        """(H, W) the unreachable regions that are visible from a reachable cell now: noise may have closed the path."""
        window = self.window
        unreachable = window.unseen & (self.failed_views == UNREACHABLE)
        labels, _ = ndimage.label(unreachable)
        visible: set[int] = set()
        edge = self.closed.edge[are_beside(unreachable, self.closed.edge)]
        for cells in frontier_clusters(edge, self.tile):
            if (
                nearest_viewpoint(self.distances.reachable, window.obstacles, *centre_cell(cells), self.sensor.reach)
                >= 0
            ):
                visible.update(labels[tuple(adjacent_cells(unreachable, cells).T)].tolist())
        return np.isin(labels, list(visible))

    def fitting_cells(self) -> Bools:
        """(H, W) the cells where the robot would fit without the clearance, in places large enough to count."""
        fitting = self.window.seen & ~too_near(self.window.obstacles, self.radius_m / self.window.cell_m)
        labels, _ = ndimage.label(fitting)
        large = np.bincount(labels.ravel()) >= self.glimpsed_cells()
        large[labels[self.window.cell(self.pose.position)]] = True
        return fitting & large[labels]

    def distances_without_clearance(self) -> Distances:
        """Distances from the robot if it may come as near to an obstacle cell's centre as its radius."""
        return distances_without_clearance(self.window, self.pose, self.radius_m)

    @property
    def tile(self) -> int:
        """Side of the squares that frontiers are split into, cells."""
        return max(1, round(_TILE_M / self.window.cell_m))


def distances_without_clearance(
    window: MapWindow, pose: Pose, radius_m: float, passed: Bools | None = None
) -> Distances:
    """Distances, in cells, from a robot that may come as near to an obstacle cell's centre as its radius.

    It may also drive where it has `passed` (H, W).
    """
    blocked = too_near(window.obstacles, radius_m / window.cell_m)
    if passed is not None:
        blocked &= ~passed
    here = window.cell(pose.position)
    blocked[here] = False
    return Distances(window.seen & ~blocked, blocked, *here)


def too_near(obstacles: Bools, radius: float) -> Bools:
    """(H, W) the cells whose centre is nearer to an obstacle cell's centre than a radius, in cells."""
    reach = math.floor(radius) + 1
    offsets = np.arange(-reach, reach + 1)
    return stamped(obstacles, np.argwhere(np.hypot(offsets[:, None], offsets[None, :]) < radius) - reach)
