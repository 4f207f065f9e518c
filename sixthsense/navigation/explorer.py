"""The interface of explorers, which choose the next view of an exploration, with its contract; the shipped ones."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.frontier import Piece
from sixthsense.navigation.gridsearch import Cell, Cells, ways_from
from sixthsense.navigation.tour import stop_order
from sixthsense.navigation.view_map import ViewMap
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.mapping.freespace import Bools

# Views in a tour: those with the shortest ways from the robot. With twice as many a choice takes 1.4 times as long.
_STOPS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Unseen cells and the cell to see them from, row and col counted from the world's origin."""

    cells: Cells
    """(N, 2) unseen cells"""
    viewpoint: Cell
    """the cell to see them from"""
    tour: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(K, 2) robot, stops and home of the tour that begins with it, world frame, m; empty if no tour was made"""


class ExplorationView:
    """What an explorer chooses from: the map of an exploration with the robot in it.

    Masks are (H, W), [row = y, col = x], of cells of `cell_m`, and may not be written to.
    """

    def __init__(self, map_: ViewMap, pose: Pose, home: Array, reach: float) -> None:
        """Show a map to a robot that sees as far as `reach`, in cells."""
        self.map, self._reach = map_, reach
        self.pose = pose
        """`T_world_robot`"""
        self.home = home
        """(2,) where the robot drives in the end, world frame, m"""
        self.cell_m = map_.cell_m
        """side of a cell, m"""
        self.free: Bools = map_.free
        """(H, W) seen cells that are no obstacle"""
        self.unseen: Bools = map_.wanted
        """(H, W) cells that are to be seen"""
        self.reachable: Bools = map_.reachable
        """(H, W) cells that the robot can drive to"""
        self.pieces: list[Piece] = map_.pieces(map_.wanted)
        """of the border between free and unseen cells"""

    def targets(self, most: int | None = None) -> list[Target]:
        """The nearest view of each piece of the border from a reachable cell, if it is worth a look.

        In the order of the ways there, and no more than `most`, if that is given: the fewer, the faster.
        """
        views = [(self.map.view_of(piece, self.map.places, self._reach), piece) for piece in self.pieces]
        seen = [(viewpoint, piece) for viewpoint, piece in views if viewpoint is not None]
        ways_m = self.map.lengths_m(np.array([viewpoint for viewpoint, _ in seen], dtype=np.int64))
        ordered = (seen[k] for k in np.argsort(ways_m, kind="stable").tolist())
        worthy = (self._target(p.unseen, v) for v, p in ordered if self.map.shows_enough(v, p, self.unseen))
        return list(itertools.islice(worthy, most))

    def target_from(self, point: ArrayLike) -> Target | None:
        """The view of all unseen cells that are visible from a point (2,), world frame, m.

        None where nothing unseen is visible, or where the robot cannot drive to.
        """
        cell = self.map.cell(np.asarray(point, dtype=np.float64))
        if not self.reachable[cell]:
            return None
        cells = visible_cells(self.map.obstacles, self.unseen, *cell, self._reach)
        return self._target(cells, cell) if len(cells) else None

    def position(self, target: Target) -> Array:
        """(2,) the point that a target is seen from, world frame, m."""
        return np.asarray((np.array(target.viewpoint)[::-1] + 0.5) * self.cell_m)

    def points(self, cells: ArrayLike) -> Array:
        """(N, 2) centres of cells (N, 2), row and col of the masks, world frame, m."""
        return self.map.points(np.asarray(cells).reshape(-1, 2))

    def ways_m(self, points: ArrayLike) -> Array:
        """(N,) lengths of the ways from the robot to points (N, 2), m; inf where no way leads."""
        places = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        cells = np.array([self.map.cell(place) for place in places], dtype=np.int64).reshape(-1, 2)
        return self.map.lengths_m(cells)

    def lengths(self, targets: list[Target]) -> Array:
        """(N + 2, N + 2) lengths of ways between the robot, the viewpoints and home, in tiles; inf without a way."""
        views = np.array([target.viewpoint for target in targets]) - self.map.first
        stops = np.vstack([self.map.here, views, self.map.cell(self.home)]) // self.map.side
        lengths, cost = np.zeros((len(stops), len(stops))), self.map.tile_cost(1.0)
        lengths[0, 1:], last = self.map.ways[tuple(stops[1:].T)], len(stops) - 1
        for k in (*range(1, last - 1), last):  # one search from home, which may be far from all views
            others = np.arange(k + 1 if k < last else 1, last)
            ways, _ = ways_from(self.map.links, cost, tuple(stops[k].tolist()), stops[others])
            lengths[k, others] = ways[tuple(stops[others].T)]
        lengths += lengths.T
        if not np.isfinite(lengths[-1]).all():
            lengths[-1] = lengths[:, -1] = 0.0  # while no way home is known the tour is open
        return lengths

    def _target(self, cells: Cells, viewpoint: Cell) -> Target:
        first = self.map.first
        return Target(cells + first, (viewpoint[0] + first[0], viewpoint[1] + first[1]))


class Explorer(Protocol):
    """Chooses where an exploration looks next.

    It is made with the run's `numpy.random.Generator` for exploration, and with an object of its `Options`, if it has
    any. What lies between two choices, driving, turning around, giving up what is not seen, and the way home, is the
    exploration's.

    1. `next_target` returns a target that the view has made, by `targets` or `target_from`; or None, if nothing is
       worth a look. The robot drives home then.
    2. Its viewpoint is a reachable cell, and all its cells are unseen.
    3. The same map, pose and state of the generator give the same target.
    4. The view and its arrays stay as they are.
    """

    def next_target(self, view: ExplorationView) -> Target | None:
        """Choose the next target."""
        ...


class FrontierExplorer:
    """The first viewpoint of a short tour through the nearest frontiers and home."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        """It draws nothing from `rng`."""

    def next_target(self, view: ExplorationView) -> Target | None:
        """Choose the first stop of the tour; None if nothing is in view of a reachable cell."""
        nearest = view.targets(_STOPS)
        if not nearest:
            return None
        order = stop_order(view.lengths(nearest)) - 1
        stops = [view.position(nearest[k]) for k in order]
        return replace(nearest[int(order[0])], tour=np.vstack([view.pose.position, *stops, view.home]))


class RandomExplorer:
    """The target nearest to a place drawn in the largest unseen area, the report's idea."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw places from `rng`."""
        self._rng = rng

    def next_target(self, view: ExplorationView) -> Target | None:
        """Choose a target near a random unseen cell, of the largest unseen area that any target is of."""
        targets, first = view.targets(), np.array(view.map.first)
        if not targets:
            return None
        areas, _ = ndimage.label(view.unseen)
        sizes = np.bincount(areas.ravel())
        of = [int(areas[tuple(target.cells[0] - first)]) for target in targets]
        largest = max(of, key=lambda area: int(sizes[area]))
        cells = np.argwhere(areas == largest) + first
        drawn = cells[self._rng.integers(len(cells))]
        found = [target for target, area in zip(targets, of, strict=True) if area == largest]
        return min(found, key=lambda target: float(((target.cells - drawn) ** 2).sum(axis=1).min()))


def target_fault(view: ExplorationView, target: Target | None) -> str:
    """What is wrong with the target of an explorer; "" if nothing."""
    if target is None:
        return ""
    if not isinstance(target, Target):
        return f"found a {type(target).__name__}, allowed: a Target of the view, or None"
    first, shape = np.array(view.map.first), np.array(view.reachable.shape)
    cell = np.array(target.viewpoint) - first
    if (cell < 0).any() or (cell >= shape).any() or not view.reachable[tuple(cell)]:
        x, y = view.position(target)
        return f"found a viewpoint at ({x:.2f}, {y:.2f}), which the robot cannot drive to"
    cells = np.asarray(target.cells).reshape(-1, 2) - first
    inside = (cells >= 0).all(axis=1) & (cells < shape).all(axis=1)
    seen = len(cells) - int(np.count_nonzero(view.unseen[tuple(cells[inside].T)]))
    return f"found a target of {len(cells)} cells, {seen} of them seen" if seen or not len(cells) else ""
