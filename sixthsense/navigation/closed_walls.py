"""The map window with closed walls, what hides from view, and the free cells at the unknown, kept up to date."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sixthsense.navigation.frontier import close_gaps, dilated
from sixthsense.navigation.map_window import MapWindow
from sixthsense.navigation.regions import Cells, frontier_cells
from sixthsense.slam.mapping.changes import Box, Revision
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.grid import Grid

_WALL_HITS, _WALL_PASSES = 3, 15  # a wall cell has at least so many hits, and at most so many passes per hit
_CLOSING = 2  # cells; how far a closing by 3 x 3 cells carries a change


class ClosedMap(NamedTuple):
    """A map window whose walls are closed."""

    window: MapWindow
    opaque: Bools
    """(H, W) its obstacles and the cells near them: a line of sight that keeps off them passes no hole in a wall"""
    edge: Cells
    """(N, 2) its free cells beside unknown ones, row by row"""


class ClosedWalls:
    """Counts as obstacles also walls that grazing beams have erased, and gaps of one or two cells."""

    def __init__(self, sight_margin: int) -> None:
        """Begin without a map. Cells within `sight_margin` rows and columns of an obstacle are opaque."""
        self._sight_margin = sight_margin
        self._spread = _CLOSING + max(1, sight_margin)  # cells; how far a change moves the edge and what is opaque
        self._of: tuple[tuple[int, int], tuple[int, ...]] | None = None
        self._revision: Revision | None = None
        self._obstacles: Bools = np.zeros((0, 0), dtype=np.bool_)
        self._opaque = self._obstacles
        self._edge: Cells = np.zeros((0, 2), dtype=np.int64)

    def close(self, window: MapWindow, grid: Grid) -> ClosedMap:
        """The window with closed walls; `window` is that of the present state of `grid`.

        The cost follows what has changed since the last call, but for the masks of the window.
        """
        shape, first = window.seen.shape, window.first
        box = grid.changes.since(self._revision) if self._of == (first, shape) else None
        if box is None:
            self._of = first, shape
            self._obstacles, self._opaque = np.zeros((2, *shape), dtype=np.bool_)
            self._edge = np.zeros((0, 2), dtype=np.int64)
            box = Box(first[0], first[1], first[0] + shape[0], first[1] + shape[1])
        self._revision = grid.changes.revision
        if box.bottom > box.top:
            self._update(window, grid, box)
        closed = self._obstacles.copy()
        return ClosedMap(
            replace(window, obstacles=closed, unseen=window.unseen & ~closed), self._opaque.copy(), self._edge
        )

    def _update(self, window: MapWindow, grid: Grid, box: Box) -> None:
        """Compute all anew where a change within `box` may have changed it."""
        first, shape = window.first, window.seen.shape
        around = box.grown(2 * self._spread)
        part, inner = around.within(first, shape), box.grown(self._spread).within(first, shape)
        rows, cols = part
        place = Box(first[0] + rows.start, first[1] + cols.start, first[0] + rows.stop, first[1] + cols.stop)
        hits, passes = grid.part("hits", place), grid.part("passes", place)
        wall = (hits >= _WALL_HITS) & (passes <= _WALL_PASSES * hits)
        closed = close_gaps(window.obstacles[part] | wall)
        own = (
            slice(inner[0].start - rows.start, inner[0].stop - rows.start),
            slice(inner[1].start - cols.start, inner[1].stop - cols.start),
        )
        # The closing is right from two cells inside `part` on, or at the window's rim.
        self._obstacles[inner] = closed[own]
        opaque = closed
        for _ in range(self._sight_margin):
            opaque = dilated(opaque)
        self._opaque[inner] = opaque[own]
        seen = window.seen[part]
        edge = np.argwhere(frontier_cells(seen & ~closed, ~(seen | closed))[own])
        edge += np.array([inner[0].start, inner[1].start])
        old = self._edge
        kept = (old[:, 0] < inner[0].start) | (old[:, 0] >= inner[0].stop)
        kept |= (old[:, 1] < inner[1].start) | (old[:, 1] >= inner[1].stop)
        cells = np.concatenate([old[kept], edge])
        self._edge = cells[np.argsort(cells[:, 0] * shape[1] + cells[:, 1])]
