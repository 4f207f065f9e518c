"""The map of one exploration: what is free, what hides, where the robot may drive, and what is to be seen.

`MapView` keeps all of it in masks (H, W) of one frame, indexed [row = y, col = x], and draws them again where the grid
has changed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation.exploration_task import TRIES, AreaToSee, Counts, Region
from sixthsense.navigation.frontier import close_gaps, close_unseen_gaps, dilated
from sixthsense.navigation.gridsearch import Reached, far_from
from sixthsense.navigation.gridsearch.reached import SQUARE, TILE
from sixthsense.navigation.guard import BUFFER_M, sees_beside
from sixthsense.navigation.regions import Cells, Nodes, frontier_cells
from sixthsense.navigation.tour import TileWays
from sixthsense.navigation.viewpoints import mark_tiles
from sixthsense.navigation.ways import track_cells
from sixthsense.slam.mapping.changes import Box, Revision, box_of
from sixthsense.slam.mapping.freespace import Bools, Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.inflation import disc

_WALL = 4  # a wall cell has so many times the fewest hits of an obstacle, and at most so many times its passes per hit
_MASKS = "seen", "free", "filled", "obstacles", "opaque", "wanted", "blocked", "passable", "tight", "_barred", "_driven"
_NOWHERE, _NO_CELLS = Box(0, 0, 0, 0), np.zeros((0, 0), dtype=np.bool_)


class MapView:
    """What an exploration knows of the map. Masks are written to by it alone, and are valid until it changes."""

    seen: Bools
    """crossed by a beam"""
    free: Bools
    """seen, and no obstacle"""
    filled: Bools
    """free, or between two beams"""
    obstacles: Bools
    """with closed walls: gaps of two cells, unseen ones up to the robot's width, and what grazing beams have erased"""
    opaque: Bools
    """obstacles and the cells near them: a line of sight that keeps off them passes no hole in a wall"""
    wanted: Bools
    """unknown cells that are to be seen"""
    blocked: Bools
    """where the robot may not drive"""
    passable: Bools
    """seen cells where it may"""
    tight: Bools
    """where the drawn cells of obstacles leave the robot no room, whether it may drive there or not"""
    edge: Cells
    """(N, 2) free cells beside unknown ones, row by row"""
    occupied: Bools
    """(H / 8, W / 8) tiles that hold an obstacle or a cell reached"""
    grid: Grid
    """the one of the latest update"""
    _barred: Bools
    """far into the unknown, or outside the limits"""
    _driven: Bools
    """where the robot has been, and beside it"""
    _changed: Bools

    def __init__(self, region: Region, radius_m: float, config: Config) -> None:
        """Begin without a map, for a disc of `radius_m` that is to see all of a region."""
        self.cell_m = cell_m = config.grid.cell_m
        self.radius = radius_m / cell_m
        """of the robot, in cells"""
        self.frame = _NOWHERE
        """the cells of the masks"""
        self.spare_m = config.grid.clearance_m - BUFFER_M if sees_beside(radius_m, config) else 0.0
        """how much of the clearance the robot gives up in narrow places: it goes where the guard lets it pass"""
        self._guard_m = radius_m + BUFFER_M
        self.tile_ways = TileWays(max(1, math.floor(2.0 * self.radius)))
        """lengths of ways over the cells reached; no way over tiles of the robot's width leads through a wall"""
        self._area = AreaToSee(region, config)
        self._unknown_reach = max(1, round(self.radius))  # unknown cells farther than this from all seen are no way
        self._sight_margin = round(0.5 * self.radius)  # that lines of sight keep off obstacles
        inflation = math.ceil((radius_m + config.grid.clearance_m) / cell_m) + 1
        self._width = math.floor(2.0 * self.radius)
        spacing = abs(float(np.subtract(*beam_bearings(config.laser)[:2])))
        self._between_beams = min(math.floor(spacing * config.laser.max_range / cell_m), self._width)
        closing = 2 + 2 * self._width  # cells; how far a closing by 3 x 3 cells, and then of gaps, carries a change
        self._spread = max(inflation, self._unknown_reach, self._sight_margin + closing, self._area.narrow_outside)
        self._revision: Revision | None = None
        self._due = _NOWHERE  # where views are to be drawn again
        self._ignored: Nodes = np.zeros(0, dtype=np.int64)
        self._left_out = self._ignored  # of the wanted cells, since they were drawn
        self._space: FreeSpace | None = None
        self._attempts: Counts = np.zeros((0, 0), dtype=np.uint8)
        self._stops: Counts = np.zeros((0, 0), dtype=np.uint8)  # of the guard, on the way to each cell
        self._config = config
        self._last: Array | None = None  # where the robot was at the latest keyframe
        self._reached = Reached(_NO_CELLS)
        self._make_masks(self.frame)

    @property
    def is_wide(self) -> bool:
        """Whether the robot may drive, and unknown cells count, as far outside the region as its laser reaches."""
        return self._area.is_wide

    @property
    def first(self) -> tuple[int, int]:
        """Row and col of the masks' corner, counted from the world's origin."""
        return self.frame.top, self.frame.left

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the masks."""
        return self.frame.bottom - self.frame.top, self.frame.right - self.frame.left

    @property
    def unseen(self) -> Bools:
        """(H, W) within the region, and neither seen nor an obstacle."""
        return self._area.of_region(~(self.seen | self.obstacles), self.frame)

    @property
    def reached(self) -> Bools:
        """(H, W) the cells that paths over seen cells lead to from the robot, when views were last drawn."""
        return self._reached.cells

    @property
    def reaches_limits(self) -> bool:
        """Whether a cell reached is at the edge of those that the robot may drive in."""
        inside = self.reached[self._area.limits.grown(-1).within(self.first, self.shape)]
        return bool(np.count_nonzero(inside) < np.count_nonzero(self.reached))

    def cell(self, point: Array) -> tuple[int, int]:
        """Row and col of a (2,) point, world frame, clipped to the masks."""
        row = math.floor(point[1] / self.cell_m) - self.frame.top
        col = math.floor(point[0] / self.cell_m) - self.frame.left
        return min(max(row, 0), self.shape[0] - 1), min(max(col, 0), self.shape[1] - 1)

    def point(self, row: float, col: float) -> Array:
        """(2,) centre of a cell, world frame."""
        return np.array([(self.frame.left + col + 0.5) * self.cell_m, (self.frame.top + row + 0.5) * self.cell_m])

    def update(self, grid: Grid) -> None:
        """Draw where the robot may drive, where the grid has changed."""
        self.grid, changes = grid, grid.changes
        frame = grid.box.aligned(SQUARE)
        box = changes.since(self._revision) if frame == self.frame else None
        self._revision = changes.revision
        if frame != self.frame:
            self._make_masks(frame)
        self.redraw(frame if box is None else box)

    def redraw(self, box: Box) -> None:
        """Draw again where the robot may drive, as far as what is in a box matters for it."""
        rows, cols = part = box.grown(self._spread).within(self.first, self.shape)
        if box.bottom == box.top or not self.seen[part].size:
            return
        inner, reach = self._box(rows, cols), self._unknown_reach
        outer = self.grid.part("seen", inner.grown(reach))
        own = slice(reach, reach + rows.stop - rows.start), slice(reach, reach + cols.stop - cols.start)
        barred = far_from(outer, reach)[own]
        inside = np.zeros_like(barred)
        inside[self._area.limits.within((inner.top, inner.left), barred.shape)] = True
        barred |= ~inside
        self.seen[part], self.tight[part] = outer[own], self.grid.inflated(inner, -self.spare_m)
        blocked = barred | self._without_room(part, inner)
        self._barred[part], self.blocked[part] = barred, blocked
        self.passable[part] = self.seen[part] & ~blocked
        self._due, self._space = _joined(self._due, inner), None

    def draw_views(self, here: tuple[int, int]) -> None:
        """Draw what views are chosen from, where it has changed, for a robot in the cell `here`."""
        self.heed()
        part = (self.frame if self._area.is_wide else self._due.aligned(SQUARE)).within(self.first, self.shape)
        self._due = _NOWHERE
        if self.seen[part].size:
            self._draw_views(*part)
            self._reached.redraw(self.passable, self.blocked, *part)
        self._reached.search(self.blocked, *here, self._changed)
        mark_tiles(self.occupied, self.reached, self.obstacles, self._changed)
        self.tile_ways.update(self.reached, self._changed)

    def heed(self) -> None:
        """Take the cells that are left out of the wanted ones among them again."""
        self.wanted.ravel()[self._left_out] = True
        self._left_out = self._left_out[:0]

    def ignore(self, cells: Nodes) -> Bools:
        """Leave (N,) flat cells out of the wanted ones, instead of those that were left out before.

        (H / 8, W / 8) the tiles of 8 cells in which the obstacles, the wanted cells, or those reached differ since the
        last call.
        """
        row, col = np.divmod(np.setxor1d(cells, self._ignored), max(self.shape[1], 1))
        self._changed[row // TILE, col // TILE] = True
        self.heed()
        self._ignored = self._left_out = cells
        self.wanted.ravel()[cells] = False
        changed: Bools = self._changed
        self._changed = np.zeros_like(changed)
        return changed

    def given_up(self) -> Bools:
        """(H, W) the cells not seen from as many viewpoints as are tried."""
        return self._area.given_up(self._attempts)

    def count_attempt(self, cells: Cells) -> None:
        """Count one more viewpoint from which (N, 2) cells, from the world's origin, were not seen, if unknown now."""
        rows, cols = np.unique(cells, axis=0).T - np.array(self.first)[:, None]
        counts = self._attempts
        missed = ~(self.seen | self.obstacles)[rows, cols] & (counts[rows, cols] < np.iinfo(counts.dtype).max)
        counts[rows[missed], cols[missed]] += 1
        self._due = _joined(self._due, box_of(cells))

    def unknown_share(self, cells: Cells) -> float:
        """Which share of (N, 2) cells, from the world's origin, is unknown as `wanted` has it; 0 of none."""
        if len(cells) == 0:
            return 0.0
        box = box_of(cells).grown(self._spread)
        known = self._known(box)[2]
        return float(np.mean(~known[cells[:, 0] - box.top, cells[:, 1] - box.left]))

    def forget_attempts(self) -> None:
        """Begin to count as if no viewpoint had been tried."""
        self._attempts[:] = 0
        self._due = self.frame

    def widen(self, is_wide: bool) -> None:
        """Let the robot drive as far outside the region as its laser reaches, or no more."""
        self._area.is_wide = is_wide
        self.redraw(self.frame)
        self._due = self.frame

    def sees_walls(self, position: Array, reach: float) -> bool:
        """Whether an obstacle lies within a reach, in cells, of a (2,) position."""
        x, y = position.tolist()
        return self.grid.has_obstacle_within((math.floor(y / self.cell_m), math.floor(x / self.cell_m)), reach)

    def moved(self, position: Array) -> None:
        """Take in where the robot is, (2,), and that it fits on its way there; it may begin inside the inflation."""
        cells = track_cells(np.array([position if self._last is None else self._last, position]), self.cell_m)
        cells = np.unique((cells[:, None] + disc(1.0)).reshape(-1, 2), axis=0)  # a way without steps across corners
        at, is_start = self._inside(cells), self._last is None
        self._last = position
        if not is_start and (self.blocked[at].any() or not self._driven[at].all()):
            self._driven[at] = True
            self.redraw(box_of(cells))

    def count_stop(self, ahead: Array) -> None:
        """Count that the guard has stopped the robot before (N, 2) places: after a few stops a tight one is closed.

        It is opened again where the whole clearance is free, after a wall has moved.
        """
        cells = track_cells(ahead, self.cell_m)
        cells = np.unique((cells[:, None] + disc(1.0)).reshape(-1, 2), axis=0)
        self._stops[self._inside(cells)] += 1
        self.redraw(box_of(cells))

    def forget_stops(self) -> None:
        """Open what is closed because the guard has stopped the robot there."""
        self._stops[:] = 0
        self.redraw(self.frame)

    def _inside(self, cells: Cells) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of those cells (N, 2), from the world's origin, that are in the masks."""
        rows, cols = (cells - np.array(self.first)).T
        inside = (rows >= 0) & (rows < self.shape[0]) & (cols >= 0) & (cols < self.shape[1])
        return rows[inside], cols[inside]

    def _without_room(self, part: tuple[slice, slice], box: Box) -> Bools:
        """(H, W) the cells of a part of the masks, a box, in which the robot does not fit, or was stopped.

        It fits where it has been, whatever is drawn there later. Without a guard it goes through nothing else that is
        tight.
        """
        covered = self.grid.part("cover", box) > 0
        driven, stopped = self._driven[part], self._stops[part] >= TRIES
        if self._config.safety.guard:
            near = self._near(part, box) if self.spare_m > 0.0 else self.tight[part]
            return np.asarray((near & ~driven) | (covered & stopped))
        touching = self.grid.inflated(box, -self._config.grid.clearance_m)
        return np.asarray(covered & (touching | ~driven))

    def _near(self, part: tuple[slice, slice], box: Box) -> Bools:
        """(H, W) the cells of a part of the masks, a box, that are too near to returns for the guard and noise.

        A cell that was open stays so up to the guard's distance: the mean of a gap's returns moves with each look, and
        a gap that is about as wide as is asked would open and close.
        """
        near = self.grid.near_returns(box, self._guard_m + 0.5 * self.spare_m)
        was_open = self.passable[part] & self.seen[part]
        if (near & was_open).any():
            near &= ~was_open | self.grid.near_returns(box, self._guard_m)
        return near

    def free_space(self, margin_m: float, places: Array, within: Ellipse | None) -> FreeSpace:
        """Where the robot may drive, (K, 2) places covered; with a margin, the cells about an ellipse."""
        cell_m, origin = self.cell_m, (self.frame.left * self.cell_m, self.frame.top * self.cell_m)
        if self._space is None:
            self._space = FreeSpace(self.blocked, self.seen, origin, cell_m)
        if within is None:
            return self._space.covering(*places)
        part = within.rows_and_cols(self.shape, origin, cell_m)
        box = self._box(*part)
        corner = box.left * cell_m, box.top * cell_m
        blocked = self.grid.inflated(box, margin_m - self.spare_m) | self.blocked[part]
        within.block_beyond(blocked, corner, cell_m)
        return FreeSpace(blocked, self.seen[part], corner, cell_m).covering(*places)

    def _make_masks(self, frame: Box) -> None:
        """Begin with masks of another frame, with what was in the present one."""
        if self._left_out.size:
            self.heed()
        before, self.frame = self.frame, frame
        self.edge, self._ignored = np.zeros((0, 2), dtype=np.int64), self._ignored[:0]
        for name in _MASKS:
            setattr(self, name, _moved(getattr(self, name, _NO_CELLS), before, frame))
        for name in ("occupied", "_changed"):
            setattr(self, name, _moved(getattr(self, name, _NO_CELLS), before, frame, TILE))
        self._attempts, self._stops = (_moved(counts, before, frame) for counts in (self._attempts, self._stops))
        self._reached = Reached(_moved(self._reached.cells, before, frame))

    def _draw_views(self, rows: slice, cols: slice) -> None:
        """Draw what views are chosen from in some rows and columns."""
        part, inner, spread_by = (rows, cols), self._box(rows, cols), 2 * self._spread
        outer = inner.grown(spread_by)
        own = slice(spread_by, spread_by + rows.stop - rows.start), slice(spread_by, spread_by + cols.stop - cols.start)
        seen, closed, known = self._known(outer)
        opaque = closed
        for _ in range(self._sight_margin):
            opaque = dilated(opaque)
        unknown, free = ~known, seen & ~closed
        attempts = _moved(self._attempts, self.frame, outer)
        wanted = self._area.to_see(unknown, outer, attempts)[own]
        edge = np.argwhere(frontier_cells(free, unknown)[own]) + np.array([rows.start, cols.start])
        differs = (self.wanted[part] != wanted) | (self.obstacles[part] != closed[own])
        tiles = differs.reshape(differs.shape[0] // TILE, TILE, -1, TILE).any(axis=(1, 3))
        self._changed[rows.start // TILE : rows.stop // TILE, cols.start // TILE : cols.stop // TILE] |= tiles
        self.wanted[part], self.obstacles[part], self.opaque[part] = wanted, closed[own], opaque[own]
        self.free[part], self.filled[part] = free[own], (known & ~closed)[own]
        old_rows, old_cols = self.edge.T
        kept = (old_rows < rows.start) | (old_rows >= rows.stop) | (old_cols < cols.start) | (old_cols >= cols.stop)
        cells = np.concatenate([self.edge[kept], edge])
        self.edge = cells[np.argsort(cells[:, 0] * self.shape[1] + cells[:, 1])]

    def _known(self, box: Box) -> tuple[Bools, Bools, Bools]:
        """(H, W) the cells of a box that were seen, those of closed walls, and both with what is between two beams."""
        seen, hits, passes = (self.grid.part(name, box) for name in ("seen", "hits", "passes"))
        least, most = self._config.grid.min_hits, self._config.grid.passes_per_hit
        wall = (hits >= _WALL * least) & (passes <= _WALL * most * hits)
        closed = close_unseen_gaps(close_gaps(self.grid.part("obstacles", box) | wall), seen, self._width)
        return seen, closed, close_unseen_gaps(seen | closed, seen, self._between_beams)

    def _box(self, rows: slice, cols: slice) -> Box:
        """The box of some rows and columns of the masks."""
        top, left = self.first
        return Box(top + rows.start, left + cols.start, top + rows.stop, left + cols.stop)


def _joined(a: Box, b: Box) -> Box:
    """The box that holds both; one without cells holds nothing."""
    if a.bottom == a.top or b.bottom == b.top:
        return b if a.bottom == a.top else a
    return Box(min(a.top, b.top), min(a.left, b.left), max(a.bottom, b.bottom), max(a.right, b.right))


def _moved(mask: NDArray[Any], before: Box, box: Box, side: int = 1) -> NDArray[Any]:
    """(H, W) what a mask of the cells of a box, or of their squares, has in another box; 0 outside."""
    height, width = box.bottom - box.top, box.right - box.left
    moved = np.zeros((height // side, width // side), dtype=mask.dtype)
    there = before.within((box.top, box.left), (height, width))
    here = box.within((before.top, before.left), (before.bottom - before.top, before.right - before.left))
    to, of = (tuple(slice(s.start // side, s.stop // side) for s in part) for part in (there, here))
    moved[to] = mask[of]
    return moved
