"""Choosing the next view: which unseen cells to look at, and from where.

`ViewPlanner` holds one map and one pose, and adds the views that it has found to those known.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.frontier import adjacent_cells, centre_cell, frontier_clusters, smallest_regions
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.regions import Cells, are_beside, in_large_regions
from sixthsense.navigation.tour import TileWays, view_order
from sixthsense.navigation.viewpoints import Cell, Viewpoints
from sixthsense.navigation.views import PIECE_M, KnownViews, View, ViewGain
from sixthsense.slam.mapping.freespace import Bools

IGNORED_AREA_FRACTION = 0.001
"""of the area seen: small unseen areas, the smallest first, that are together no larger are not worth a way"""
_SEEN_FRACTION = 0.2  # a target is seen when no more than this share of it is unknown


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Unseen cells and the cell to see them from, row and col counted from the world's origin."""

    cells: Cells
    """(N, 2) unseen cells"""
    viewpoint: Cell
    """the cell to see them from"""
    tour: Cells = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    """(K, 2) the stops of the tour that begins with it; empty for one that no tour has chosen"""

    def is_seen(self, view: MapView) -> bool:
        """Whether little of it is still unknown."""
        return view.unknown_share(self.cells) <= _SEEN_FRACTION


NO_TARGET = Target(np.zeros((0, 2), dtype=np.int64), (0, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The unseen cells to look at and the frontiers beside them."""

    wanted: Bools
    """(H, W) unseen cells to be seen"""
    clusters: list[Cells]
    """frontier cells beside them, (N, 2) each, row and col in the map's frame"""
    dust: float
    """cells that may be left unseen"""


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlanner:
    """Chooses the next view from the map and the robot's pose."""

    gain: ViewGain
    """of the map"""
    pose: Pose
    """the robot's"""
    reachable: Bools
    """(H, W) the cells that paths lead to from the robot"""
    viewpoints: Viewpoints
    """the search among the cells that it may look from"""
    ways: TileWays
    """over the reachable cells"""
    config: Config
    home: Array
    """(2,) where the tour ends, world frame"""
    known: KnownViews
    """views of the clusters' centres; centres that no reachable cell of this map sees, or whose view shows nothing"""

    @property
    def view(self) -> MapView:
        """The map."""
        return self.gain.view

    def candidates(self, connected: Bools | None = None) -> Candidates:
        """What may be looked at: unseen cells that were not given up, beside free cells that are not noise.

        A place counts that is `connected` (H, W), by edges of cells, to the robot's or large; the free cells connect.
        """
        view = self.view
        view.heed()
        wanted = view.wanted
        edge = view.edge[are_beside(wanted, view.edge)]
        edge = edge[
            in_large_regions(
                view.free if connected is None else connected,
                edge,
                self.glimpsed_cells(),
                view.cell(self.pose.position),
            )
        ]
        spare = IGNORED_AREA_FRACTION * np.count_nonzero(view.seen)
        ignored = smallest_regions(wanted, edge, spare)
        self.known.forget(view.ignore(ignored), view.first)
        edge = edge[are_beside(wanted, edge)]
        first = np.array(view.first)
        return Candidates(wanted, frontier_clusters(edge, self.tile, first), spare)

    def glimpsed_cells(self) -> int:
        """Fewest free cells of a place that counts though it is not connected to the robot's: those of a whole tile.

        A room may have been seen through a door which the map has closed since, after an error of the pose perhaps.
        """
        return self.tile**2

    def best(self, candidates: Candidates) -> Target | None:
        """The first stop of a short tour through the views; None if all that is visible together is dust."""
        view = self.view
        found = self._some_views(candidates)
        found = [found[k] for k in self.known.worthwhile([key for _, key, _ in found], candidates.dust)]
        if not found:
            return None
        views, here = np.array([cell for *_, cell in found]), view.cell(self.pose.position)
        order = view_order(self.ways, here, views, view.cell(self.home))
        cells, _, cell = found[order[0]]
        return replace(self.target_of(candidates.wanted, cells, cell), tour=views[order] + np.array(view.first))

    def _some_views(self, candidates: Candidates) -> list[tuple[Cells, Cell, Cell]]:
        """The clusters that have a view, with the key of their centre and the view; far off, not all of one square.

        There beams cut a frontier into many pieces. After the largest one in a square whose view shows more than may
        be left, the others wait: what that view leaves of them is looked at afterwards.
        """
        found, done = [], set()
        clusters = candidates.clusters
        begins = np.array([cells[0] for cells in clusters])
        squares = list(map(tuple, ((begins + self.view.first) // self.tile).tolist()))
        is_far = np.hypot(*(begins - self.view.cell(self.pose.position)).T) > self.gain.sensor.gapless_reach
        for k in sorted(range(len(clusters)), key=lambda k: len(clusters[k]), reverse=True):
            if squares[k] in done:
                continue
            key, view = self.view_beside(candidates, clusters[k])
            if view.cell is not None:
                found.append((clusters[k], key, self.local(view.cell)))
                if is_far[k] and view.shown > candidates.dust:
                    done.add(squares[k])
        return found

    def sample_random(self, candidates: Candidates, rng: np.random.Generator) -> Target | None:
        """The target nearest to a random cell of the largest unseen area with a visible cluster (the report's idea)."""
        labels, _ = ndimage.label(candidates.wanted)
        sizes = np.bincount(labels.ravel())
        found: dict[int, list[tuple[Cells, Target]]] = {}
        for cells in candidates.clusters:
            target = self.target_beside(candidates, cells)
            if target is not None:
                row, col = target.cells[0] - self.view.first
                found.setdefault(int(labels[row, col]), []).append((cells, target))
        if not found:
            return None
        label = max(found, key=lambda k: int(sizes[k]))
        area = np.argwhere(labels == label)
        sample = area[rng.integers(len(area))]
        return min(found[label], key=lambda pair: float(((pair[0] - sample) ** 2).sum(axis=1).min()))[1]

    def target_beside(self, candidates: Candidates, cells: Cells) -> Target | None:
        """The unseen cells beside a cluster, with the nearest viewpoint; None if no view is worth while."""
        _, view = self.view_beside(candidates, cells)
        return None if view.cell is None else self.target_of(candidates.wanted, cells, self.local(view.cell))

    def view_beside(self, candidates: Candidates, cells: Cells) -> tuple[Cell, View]:
        """The key of a cluster's centre, and what the search for its nearest view finds.

        A view past the edge of an obstacle, which itself shows nothing, counts as one from nearby, where the robot
        would fit without the clearance.
        """
        centre = centre_cell(cells)
        key = self.key(centre)
        known = self.known.get(key)
        if known is not None and known.is_known_beyond(candidates.dust):
            return key, known
        view, gain = self.viewpoints.nearest(centre), self.gain
        enough = 2.0 * candidates.dust  # which grows with the map
        found = View(None, 0, int(gain.sensor.reach))
        if view is not None:
            asked = candidates.wanted, view, centre
            shown = gain.shown(*asked, enough) or gain.shown_nearby(candidates.wanted, centre, enough)
            found = View(self.key(view) if shown else None, shown, gain.span(view, centre), enough)
        self.known.add(key, found)
        return key, found

    def target_of(self, wanted: Bools, cells: Cells, view: Cell) -> Target:
        """The cells of `wanted` beside a cluster, to be seen from a cell of the frame."""
        return Target(adjacent_cells(wanted, cells) + self.view.first, self.key(view))

    def key(self, cell: Cell) -> Cell:
        """A cell of the frame, counted from the world's origin."""
        return cell[0] + self.view.frame.top, cell[1] + self.view.frame.left

    def local(self, cell: Cell) -> Cell:
        """A cell from the world's origin, in the frame."""
        return cell[0] - self.view.frame.top, cell[1] - self.view.frame.left

    @property
    def tile(self) -> int:
        """Side of the squares that frontiers are split into, cells."""
        return max(1, round(PIECE_M / self.view.cell_m))
