"""Choosing the next view: which unseen cells to look at, and from where.

`ViewPlanner` holds one map and one pose, and remembers the views that it has found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.driving_limits import Widening
from sixthsense.navigation.frontier import (
    adjacent_cells,
    centre_cell,
    drop_small_regions,
    frontier_clusters,
)
from sixthsense.navigation.known_views import KnownViews, View
from sixthsense.navigation.map_window import NOWHERE, MapWindow, Target
from sixthsense.navigation.regions import Cells, are_beside, in_large_regions, spread
from sixthsense.navigation.tour import first_view
from sixthsense.navigation.view_gain import ViewGain
from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.slam.mapping.freespace import Bools

_TILE_M = 1.0  # longer frontiers are split
_GLIMPSED_M2 = 1.0  # free cells that are not connected to the robot's count as a place if they are so many


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The unseen cells to look at and the frontiers beside them."""

    wanted: Bools
    """(H, W) unseen cells to be seen"""
    clusters: list[Cells]
    """frontier cells beside them, (N, 2) each, row and col in the window"""
    dust: float
    """cells that may be left unseen"""


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlanner:
    """Chooses the next view from the map and the robot's pose."""

    gain: ViewGain
    """of the map within the driving limits"""
    failed_views: NDArray[np.uint8]
    """(H, W) how often each cell was not seen from a viewpoint chosen for it"""
    pose: Pose
    """the robot's"""
    reachable: Bools
    """(H, W) the cells that paths lead to from the robot"""
    viewpoints: Viewpoints
    """the search among the cells that it can reach"""
    config: Config
    home: Array
    """(2,) where the tour ends, world frame"""
    known: KnownViews
    """views of the clusters' centres; centres that no reachable cell of this map sees, or whose view shows nothing"""

    @property
    def window(self) -> MapWindow:
        """The map within the driving limits, with closed walls."""
        return self.gain.closed.window

    def next_target(self, candidates: Candidates, rng: np.random.Generator) -> Target | None:
        """The best view of the candidates, by the configured method; None if no view from a reachable cell is left."""
        if not candidates.clusters:
            return None
        if self.config.explore.method == "random":
            return self.sample_random(candidates, rng)
        return self.best(candidates)

    def candidates(self, widening: Widening) -> Candidates:
        """What may be looked at: unseen cells that were not given up, beside free cells that are not noise.

        Unknown cells outside the region count as far as `widening` says, for a part of the region may be visible only
        across its edge.
        """
        window, explore = self.window, self.config.explore
        few, widened = self.failed_views < explore.tries, widening.step > 0
        unknown = window.unknown
        # Cells that were looked at and not seen are no reason to drive farther outside.
        sought = window.unseen & few if widened else window.unseen
        steps = max(1, round(widening.outside_m / window.cell_m))
        wanted = spread(sought, unknown, steps, NOWHERE if widened else window.inside) & few
        edge = self.gain.closed.edge
        edge = edge[are_beside(wanted, edge)]
        edge = edge[in_large_regions(window.free, edge, self.glimpsed_cells(), window.cell(self.pose.position))]
        dust = explore.dust * np.count_nonzero(window.seen)
        wanted, edge = drop_small_regions(wanted, edge, dust)
        self.known.update(window.first, (self.reachable, window.obstacles, wanted))
        return Candidates(wanted, frontier_clusters(edge, self.tile), dust)

    def glimpsed_cells(self) -> int:
        """Fewest free cells of a place that counts though it is not connected to the robot's.

        A room that was seen through a door which the map has closed since, after an error of the pose perhaps, is none
        that nobody need look at.
        """
        cell_m2 = self.window.cell_m**2
        cells = math.ceil(_GLIMPSED_M2 / cell_m2)
        return cells - 1 if (cells - 1) * cell_m2 >= _GLIMPSED_M2 else cells

    def best(self, candidates: Candidates) -> Target | None:
        """The first stop of a short tour through the views; None if all that is visible together is dust."""
        window = self.window
        found = [
            (cells, *view) for cells in candidates.clusters if (view := self.view_beside(candidates.wanted, cells))
        ]
        found = [found[k] for k in self.known.worthwhile([centre_cell(cells) for cells, *_ in found], candidates.dust)]
        if not found:
            return None
        views, here = np.array([view for _, view, _ in found]), window.cell(self.pose.position)
        # A wall is inflated to more than twice the robot's radius: no way over such tiles leads through one.
        tile = max(1, math.floor(2.0 * self.gain.radius_m / window.cell_m))
        k = first_view(self.reachable, tile, here, views, window.cell(self.home))
        return self.target_of(candidates.wanted, found[k][0], found[k][1])

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
        found = self.view_beside(wanted, cells)
        return None if found is None else self.target_of(wanted, cells, found[0])

    def view_beside(self, wanted: Bools, cells: Cells) -> tuple[tuple[int, int], int] | None:
        """The nearest viewpoint of a cluster, and how many cells it shows; None if no view is worth while.

        A view past the edge of an obstacle, which itself shows nothing, counts as one from nearby, where the robot
        would fit without the clearance.
        """
        centre = centre_cell(cells)
        known = self.known.get(centre)
        if known is not None:
            return None if known.cell is None else (known.cell, known.shown)
        view = self.viewpoints.nearest(centre)
        shown = 0 if view is None else self.gain.shown(wanted, view, centre) or self.gain.shown_nearby(wanted, centre)
        if view is None or shown == 0:
            span = int(self.gain.sensor.reach) if view is None else self.gain.span(view, centre)
            self.known.add(centre, View(None, 0, span))
            return None
        self.known.add(centre, View(view, shown, self.gain.span(view, centre)))
        return view, shown

    def target_of(self, wanted: Bools, cells: Cells, view: tuple[int, int]) -> Target:
        """The cells of `wanted` beside a cluster, to be seen from a cell of the window."""
        first = self.window.first
        return Target(adjacent_cells(wanted, cells) + first, (view[0] + first[0], view[1] + first[1]))

    @property
    def tile(self) -> int:
        """Side of the squares that frontiers are split into, cells."""
        return max(1, round(_TILE_M / self.window.cell_m))
