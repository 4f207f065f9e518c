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

    window: MapWindow
    """the map within the driving limits, with closed walls"""
    edge: Cells
    """(N, 2) its free cells beside unknown ones, row by row"""
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
    """centres of clusters that no reachable cell of this map sees"""

    def next_target(self, outside_m: float, widened: bool, rng: np.random.Generator) -> Target | None:
        """The best view, by the configured method; else the nearest occluded cells; None if nothing is left to see.

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
        return target or self.nearest_occluded(candidates)

    def candidates(self, outside_m: float, widened: bool) -> Candidates:
        """What may be looked at: unseen cells that were not given up, beside free cells that are not noise."""
        window, explore = self.window, self.config.explore
        few = self.failed_views < explore.tries
        unknown = window.unknown
        # Cells that were looked at and not seen are no reason to drive farther outside.
        sought = window.unseen & (few | (self.failed_views == UNREACHABLE)) if widened else window.unseen
        steps = max(1, round(outside_m / window.cell_m))
        wanted = spread(sought, unknown, steps, NOWHERE if widened else window.inside) & few
        edge = self.edge[are_beside(wanted, self.edge)]
        edge = edge[in_large_regions(window.free, edge, self._glimpsed_cells(), window.cell(self.pose.position))]
        wanted, edge = drop_small_regions(wanted, edge, explore.dust * np.count_nonzero(window.seen))
        return Candidates(wanted, frontier_clusters(edge, self.tile))

    def _glimpsed_cells(self) -> int:
        """Fewest free cells of a place that counts though it is not connected to the robot's.

        A room that was seen through a door which the map has closed since, after an error of the pose perhaps, is none
        that nobody need look at.
        """
        cell_m2 = self.window.cell_m**2
        cells = math.ceil(_GLIMPSED_M2 / cell_m2)
        return cells - 1 if (cells - 1) * cell_m2 >= _GLIMPSED_M2 else cells

    def best(self, candidates: Candidates) -> Target | None:
        """The visible target with the largest gain per time; None if no cluster is visible from a reachable cell."""
        window, explore, robot = self.window, self.config.explore, self.config.robot
        depth = round(_GAIN_DEPTH_M / window.cell_m)
        # An uncertain robot prefers near targets.
        seconds_per_cell = (1.0 + self.sigma_m / explore.revisit_sigma_m) * window.cell_m / robot.speed
        here = window.cell(self.pose.position)
        views: list[_View] = []
        away = [math.dist(here, centre) for centre in centre_cells(candidates.clusters).tolist()]
        for k in np.argsort(away, kind="stable").tolist():
            if len(views) == _MAX_VIEWS:
                break
            target = self.target_beside(candidates.wanted, candidates.clusters[k])
            if target is None:
                continue
            row, col = target.viewpoint_in(window)
            gain = expected_gain(
                window.obstacles, candidates.wanted, row, col, self.sensor.rays, self.sensor.reach, depth
            )
            area = max(gain, len(target.cells)) * window.cell_m**2
            ahead = window.point(row, col) - self.pose.position
            turn = abs(wrap_angle(math.atan2(ahead[1], ahead[0]) - self.pose.theta)) if ahead.any() else 0.0
            views.append(_View(target, row, col, area**explore.gain_exponent, turn / robot.turn_rate))
        best = best_view(views, self.distances, seconds_per_cell, explore.overhead_s)
        return None if best is None else views[best].target

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
        """The cells of `wanted` beside a cluster, with the nearest viewpoint; None if there is none."""
        centre = centre_cell(cells)
        if self.hidden.has(*centre):
            return None
        index = nearest_viewpoint(self.distances.reachable, self.window.obstacles, *centre, self.sensor.reach)
        if index < 0:
            self.hidden.add(*centre)
            return None
        first = self.window.first
        row, col = divmod(index, wanted.shape[1])
        return Target(adjacent_cells(wanted, cells) + first, (row + first[0], col + first[1]), False)

    def nearest_occluded(self, candidates: Candidates) -> Target:
        """The target of the clusters that no reachable cell sees, with the least distance to its viewpoint.

        The viewpoint is the last reachable cell before a gap that only the clearance closes, a door perhaps, else the
        reachable cell nearest to the cluster. There must be a cluster.
        """
        without_clearance = self.distances_without_clearance()
        reachable = np.argwhere(self.distances.reachable)
        targets = [
            self._occluded_target(candidates.wanted, cells, without_clearance, reachable)
            for cells in candidates.clusters
        ]
        return min(targets, key=lambda target: self.distances.to(*target.viewpoint_in(self.window)))

    def _occluded_target(self, wanted: Bools, cells: Cells, without_clearance: Distances, reachable: Cells) -> Target:
        window = self.window
        centre = centre_cell(cells)
        beyond = nearest_viewpoint(without_clearance.reachable, window.obstacles, *centre, self.sensor.reach)
        gap = divmod(beyond, wanted.shape[1])
        cost = without_clearance.to_all()
        cell = cell_before_gap(self.distances.reachable, cost, *gap) if beyond >= 0 else None
        if cell is None:
            nearest = int(np.argmin(((reachable - centre) ** 2).sum(axis=1)))
            cell = int(reachable[nearest, 0]), int(reachable[nearest, 1])
        viewpoint = cell[0] + window.first[0], cell[1] + window.first[1]
        return Target(adjacent_cells(wanted, cells) + window.first, viewpoint, True)

    def visible_again(self) -> Bools:
        """(H, W) the unreachable regions that are visible from a reachable cell now: noise may have closed the path."""
        window = self.window
        unreachable = window.unseen & (self.failed_views == UNREACHABLE)
        labels, _ = ndimage.label(unreachable)
        visible: set[int] = set()
        edge = self.edge[are_beside(unreachable, self.edge)]
        for cells in frontier_clusters(edge, self.tile):
            if (
                nearest_viewpoint(self.distances.reachable, window.obstacles, *centre_cell(cells), self.sensor.reach)
                >= 0
            ):
                visible.update(labels[tuple(adjacent_cells(unreachable, cells).T)].tolist())
        return np.isin(labels, list(visible))

    def distances_without_clearance(self) -> Distances:
        """Distances from the robot if it may come as near to an obstacle cell's centre as its radius."""
        return distances_without_clearance(self.window, self.pose, self.radius_m)

    @property
    def tile(self) -> int:
        """Side of the squares that frontiers are split into, cells."""
        return max(1, round(_TILE_M / self.window.cell_m))


def distances_without_clearance(window: MapWindow, pose: Pose, radius_m: float) -> Distances:
    """Distances, in cells, from a robot that may come as near to an obstacle cell's centre as its radius."""
    reach = math.floor(radius_m / window.cell_m) + 1
    offsets = np.arange(-reach, reach + 1)
    away_m = np.sqrt(offsets[:, None] ** 2 + offsets[None, :] ** 2) * window.cell_m
    blocked = stamped(window.obstacles, np.argwhere(away_m < radius_m) - reach)
    here = window.cell(pose.position)
    blocked[here] = False
    return Distances(window.seen & ~blocked, blocked, *here)
