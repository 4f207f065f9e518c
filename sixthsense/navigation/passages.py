"""Passages: ways without clearance, which the robot takes when nothing else is left to see, or to come home.

A gap may be closed by the clearance alone, and by cells that are wider than the walls in them. Whether the robot fits
is found by trying: the guard stops it before it touches what its laser sees. Then the passage is closed again.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.driving_limits import track_cells
from sixthsense.navigation.gridsearch import Distances, shortest_path
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.navigation.view_planner import ViewPlanner
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_INTO_WALLS = 0.5  # cells that the robot may reach into those of obstacles: a wall is thinner than its cells
_DRIFTED = 2.0  # cells that walls may have moved onto the way the robot came, by errors of its pose
_PASSED_M = 0.3  # from the end of a passage: a robot so near to it has come through


class Passages:
    """Tracks along which the robot may drive without its clearance."""

    def __init__(self, clearance_m: float, guarded: bool) -> None:
        """Begin without any; a robot that is not `guarded` opens none."""
        self._clearance_m = clearance_m
        self._guarded = guarded
        self._tracks: list[Array] = []
        self._driven = np.zeros((0, 2))
        self._tried: set[tuple[int, ...]] = set()
        """squares that hold the views at their ends"""
        self._passed = True
        """whether the robot has come through the latest one"""

    def open_back(self, positions: Array) -> None:
        """Let the robot drive where it has been, at `positions` (N, 2), world frame.

        It has touched nothing there, though its disc may touch an obstacle cell by now: noise makes walls thicker.
        """
        self._driven = positions

    def open_to(self, planner: ViewPlanner, place: UnseenPlace, grid: Grid) -> Bools | None:
        """Open a passage to a view of a place that was left; (H, W) the unseen cells that the view shows.

        None if there is none, or if one to there was tried before.
        """
        if not self._guarded:
            return None
        window, reachable = planner.window, planner.distances.reachable
        (top, left), (height, width) = window.first, reachable.shape
        margin_m = -self._clearance_m - _INTO_WALLS * window.cell_m
        tight = grid.inflated(Box(top, left, top + height, left + width), margin_m)
        passable = window.free & ~tight | reachable
        here = window.cell(planner.pose.position)
        passable[here] = True
        beyond = Distances(passable, ~passable, *here).reachable & ~reachable
        view = planner.gain.viewpoints(beyond).nearest(window.cell(np.array([place.x, place.y])))
        if view is None:
            return None
        square = tuple((np.add(view, window.first) // round(_PASSED_M / window.cell_m)).tolist())
        if square in self._tried:
            return None
        self._tried.add(square)
        cells, _, _ = shortest_path(~passable, here, view)
        if not len(cells):
            return None
        # From the last cell that the robot reaches with its clearance to the first behind the gap.
        cells = cells[np.flatnonzero(reachable[tuple(cells.T)]).max(initial=0) :]
        tight_at = np.flatnonzero(window.blocked[tuple(cells.T)])
        cells = cells[: tight_at.max() + 2] if len(tight_at) else cells
        self._tracks.append((cells[:, ::-1] + window.first[::-1] + 0.5) * window.cell_m)
        self._passed = False
        return visible_cells(planner.gain.closed.opaque, window.unseen, *view, planner.gain.sensor.reach)

    def moved(self, position: Array) -> bool:
        """Take in where the robot is, (2,); whether it has just come through the latest passage."""
        if self._passed or math.dist(position, self._tracks[-1][-1]) > _PASSED_M:
            return False
        self._passed = True
        return True

    def close_untried(self) -> None:
        """Close the latest passage unless the robot has come through it."""
        if not self._passed:
            self._tracks.pop()
            self._passed = True

    def unblock(self, blocked: Bools, space: FreeSpace, grid: Grid) -> None:
        """Clear the `blocked` cells (H, W) of a space along the passages where the robot fits without the clearance."""
        for track in self._tracks:
            self._unblock_along(track, _INTO_WALLS * space.cell_m, blocked, space, grid)
        if len(self._driven):
            self._unblock_along(self._driven, _DRIFTED * space.cell_m if self._guarded else 0.0, blocked, space, grid)

    def _unblock_along(self, track: Array, depth_m: float, blocked: Bools, space: FreeSpace, grid: Grid) -> None:
        """Clear the cells along a track where the robot's disc reaches at most `depth_m` into those of obstacles."""
        first = round(space.origin[1] / space.cell_m), round(space.origin[0] / space.cell_m)
        cells = np.floor(track[:, ::-1] / space.cell_m).astype(np.int64)
        (top, left), (bottom, right) = (cells.min(axis=0) - 1).tolist(), (cells.max(axis=0) + 2).tolist()
        rows, cols = Box(top, left, bottom, right).within(first, blocked.shape)
        inside = Box(first[0] + rows.start, first[1] + cols.start, first[0] + rows.stop, first[1] + cols.stop)
        if not blocked[rows, cols].size:
            return
        corner = inside.left * space.cell_m, inside.top * space.cell_m
        along = track_cells(track, corner, space.cell_m, blocked[rows, cols].shape)
        blocked[rows, cols] &= ~along | grid.inflated(inside, -self._clearance_m - depth_m)
