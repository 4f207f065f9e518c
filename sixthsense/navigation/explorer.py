"""The interface of explorers, which choose the next view of an exploration, with its contract; the shipped ones."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.view_planner import Candidates, Target, ViewPlanner
from sixthsense.navigation.visibility import mark_visible
from sixthsense.slam.mapping.freespace import Bools


class ExplorationView:
    """What an explorer chooses from: the map of an exploration with the robot in it.

    Masks are (H, W), [row = y, col = x], of cells of `cell_m`, and may not be written to.
    """

    def __init__(self, planner: ViewPlanner, candidates: Candidates) -> None:
        """Show the map of a view planner, and the frontiers that it has found."""
        self.planner, self.candidates = planner, candidates
        self.pose: Pose = planner.pose
        """`T_world_robot`"""
        self.home: Array = planner.home
        """(2,) where the robot drives in the end, world frame, m"""
        self.cell_m: float = planner.view.cell_m
        """side of a cell, m"""
        self.free: Bools = planner.view.free
        """(H, W) seen cells that are no obstacle"""
        self.unseen: Bools = candidates.wanted
        """(H, W) cells that are to be seen"""
        self.reachable: Bools = planner.reachable
        """(H, W) cells that the robot can drive to"""

    @property
    def frontiers(self) -> list[Array]:
        """(N, 2) points of each piece of the border between free and unseen cells, world frame, m."""
        return [self.points(cells) for cells in self.candidates.clusters]

    def targets(self) -> list[Target]:
        """A view of each piece of the border that can be seen from a reachable cell, and is worth a look."""
        found = (self.planner.target_beside(self.candidates, cells) for cells in self.candidates.clusters)
        return [target for target in found if target is not None]

    def target_from(self, point: ArrayLike) -> Target | None:
        """The view of all unseen cells that are visible from a point (2,), world frame, m.

        None where nothing unseen is visible, or where the robot cannot drive to.
        """
        view, row_col = self.planner.view, self.planner.view.cell(np.asarray(point, dtype=np.float64))
        if not self.reachable[row_col]:
            return None
        visible = np.zeros_like(self.unseen)
        mark_visible(visible, view.opaque, self.unseen, *row_col, self.planner.gain.sensor.reach)
        cells = np.argwhere(visible)
        return Target(cells + np.array(view.first), self.planner.key(row_col)) if len(cells) else None

    def position(self, target: Target) -> Array:
        """(2,) the point that a target is seen from, world frame, m."""
        return self.planner.view.point(*self.planner.local(target.viewpoint))

    def points(self, cells: ArrayLike) -> Array:
        """(N, 2) centres of cells (N, 2), row and col of the masks, world frame, m."""
        rows_cols = np.asarray(cells, dtype=np.float64).reshape(-1, 2)
        return self.planner.view.point(0, 0) + self.cell_m * rows_cols[:, ::-1]

    def ways_m(self, points: ArrayLike) -> Array:
        """(N,) lengths of the ways from the robot to points (N, 2), m; inf where no way leads."""
        view, places = self.planner.view, np.asarray(points, dtype=np.float64).reshape(-1, 2)
        cells = np.array([view.cell(place) for place in places], dtype=np.int64).reshape(-1, 2)
        return self.cell_m * self.planner.ways.lengths(view.cell(self.pose.position), cells)


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
    """The first viewpoint of a short tour through all frontiers and home."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        """It draws nothing from `rng`."""

    def next_target(self, view: ExplorationView) -> Target | None:
        """Choose the first stop of the tour; None if all that is visible together is not worth a way."""
        return view.planner.best(view.candidates)


class RandomExplorer:
    """The target nearest to a place drawn in the largest unseen area, the report's idea."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw places from `rng`."""
        self._rng = rng

    def next_target(self, view: ExplorationView) -> Target | None:
        """Choose a target near a random unseen cell."""
        return view.planner.sample_random(view.candidates, self._rng)


def target_fault(view: ExplorationView, target: Target | None) -> str:
    """What is wrong with the target of an explorer; "" if nothing."""
    if target is None:
        return ""
    if not isinstance(target, Target):
        return f"found a {type(target).__name__}, allowed: a Target of the view, or None"
    row, col = view.planner.local(target.viewpoint)
    rows, cols = view.reachable.shape
    if not (0 <= row < rows and 0 <= col < cols) or not view.reachable[row, col]:
        x, y = view.position(target)
        return f"found a viewpoint at ({x:.2f}, {y:.2f}), which the robot cannot drive to"
    cells = np.asarray(target.cells).reshape(-1, 2) - np.array(view.planner.view.first)
    inside = (cells >= 0).all(axis=1) & (cells < (rows, cols)).all(axis=1)
    seen = len(cells) - int(np.count_nonzero(view.unseen[tuple(cells[inside].T)]))
    return f"found a target of {len(cells)} cells, {seen} of them seen" if seen or not len(cells) else ""
