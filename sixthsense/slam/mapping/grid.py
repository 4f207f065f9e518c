"""The hit grid and the sense grid (report sections 4.4 and 4.5): evidence per cell, and inflation.

Cells are aligned to multiples of `cell_m` in the world, and indexed [row = y, col = x].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import MAX_CELLS, TILE, Box, Changes, Revision, box_of, cell_box, grown_box
from sixthsense.slam.mapping.evidence import (
    OFFSET,
    SCANS_PER_STAMP,
    Cells,
    EvidenceRules,
    Ints,
    ScanCells,
    count_scan,
    touched_squares,
)
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.inflation import check_inflation, disc, disc_cells
from sixthsense.slam.mapping.submap import Submap, add_submap, erase, mark_obstacles, submap_of
from sixthsense.slam.mapping.tiles import ROW, Places, Tiles

__all__ = ["FreeSpace", "Grid"]


CellField = Literal["hits", "passes", "cover", "seen", "obstacles", "down", "across"]


class Masks(NamedTuple):
    """Masks of a grid, (H, W), read-only: snapshots are made of them without a copy."""

    box: Box
    revision: Revision
    seen: Bools
    covered: Bools
    """by the inflation of an obstacle"""


class Grid:
    """Hit grid and sense grid in one: counts hits and passes per cell, and grows as the robot sees more.

    Evidence is counted once per scan: a scan adds at most one hit and one pass to a cell, and a hit takes precedence,
    so that beams grazing along a wall do not erase it. A cell is an obstacle when it has at least `min_hits` hits and
    at most `passes_per_hit` passes per hit, so that a stray return does not block for ever. A hit makes an obstacle at
    once, however long the cell has been free: earlier passes are cut to the most that still leave it an obstacle.
    Hits beyond `max_hits` are not counted, so that a wall that was drawn in the wrong place can be erased.

    Obstacles are inflated by the robot's true disc: a cell is blocked when a disc of `radius_m` + `clearance_m` about
    its centre touches the square of an obstacle cell. A robot elsewhere in a free cell is at most 0.71 cells from the
    centre, which a clearance of that much absorbs.
    """

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Make an empty grid for a robot that is a disc of `radius_m`; ValueError if that is negative."""
        if not (math.isfinite(radius_m) and radius_m >= 0.0):
            raise ValueError(f"radius_m: found {radius_m}, allowed: at least 0")
        self._config = config
        self._rules = EvidenceRules(config.min_hits, config.max_hits, config.passes_per_hit)
        self._inflation = (radius_m + config.clearance_m) / config.cell_m
        """cells"""
        check_inflation(self._inflation)
        self._stencil = disc(self._inflation)
        self.changes = Changes()
        """where the evidence, or who stands in the way, has changed"""
        self._reach = int(self._stencil.max(initial=0))
        self._offsets: Places = self._stencil[:, 0] * ROW + self._stencil[:, 1]
        self.clear()

    @classmethod
    def from_counts(
        cls, config: GridConfig, radius_m: float, origin: tuple[float, float], hits: Ints, passes: Ints, seen: Bools
    ) -> Grid:
        """The grid that has these counts: what `hits`, `passes`, `seen` and `origin` of another one said.

        Obstacles and their inflation follow from the counts; scans may be added to it as to the other one. Raises
        ValueError for arrays of different shapes and for an origin that is not finite.
        """
        if not hits.ndim == 2 or not hits.shape == passes.shape == seen.shape:
            raise ValueError(f"counts: expected one shape (H, W), got {hits.shape}, {passes.shape} and {seen.shape}")
        if not np.isfinite(origin).all():
            raise ValueError(f"origin: found {origin}, allowed: finite numbers")
        grid = cls(config, radius_m)
        row, col = round(origin[1] / config.cell_m), round(origin[0] / config.cell_m)
        grid._cells = grid._no_cells(max(config.max_hits, int(hits.max(initial=0))))
        grid._box = Box(row, col, row + hits.shape[0], col + hits.shape[1])
        grid._tiles.cover(grid._box.grown(grid._reach))
        kept = np.nonzero((hits > 0) | (passes > 0) | seen)
        places = grid._make_room(np.stack([kept[0] + row, kept[1] + col], axis=1), hits[kept] > 0)
        slots, cells = grid._tiles.slots(places), grid._cells
        cells.hits[slots], cells.passes[slots], cells.seen[slots] = hits[kept], passes[kept], seen[kept]
        mark_obstacles(cells, grid._tiles.index, grid._tiles.squares, grid._offsets, grid._rules)
        return grid

    def clear(self) -> None:
        """Remove all evidence and all bodies, to rebuild the grid from stored scans."""
        self.changes.add_all()
        self._box = Box(0, 0, 0, 0)
        self._scans = 0
        self._tiles, self._cells = Tiles(), self._no_cells(self._rules.max_hits)
        self._bodies: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        """(N, 2) cells, row, col from the world's origin, of who stands in the way"""
        self._masks: Masks | None = None

    def add(self, T_world_robot: Pose, scan: Scan, walls_robot: Array) -> Box:
        """Count one scan taken at `T_world_robot`, and the (W, 2, 2) wall segments (robot frame, metres) fitted to it.

        Returns the box of the cells that may have changed, without inflation.

        A beam with a return hits the cell of its end and passes those before it. A beam without one (at or beyond
        the scan's maximum) passes all cells up to the maximum, or none if so configured. A NaN, zero or negative range
        is no evidence. Raises ValueError for walls of another shape, for a pose, walls or maximum that are not finite,
        and when the grid would grow beyond 100 million cells; the grid is then unchanged.
        """
        walls = np.asarray(walls_robot, dtype=np.float64)
        if walls.ndim != 3 or walls.shape[1:] != (2, 2):
            raise ValueError(f"walls_robot: expected shape (W, 2, 2), got {walls.shape}")
        if not math.isfinite(scan.max_range):
            raise ValueError(f"max_range: found {scan.max_range}, allowed: a finite number")
        T_world_laser = T_world_robot @ scan.T_robot_laser
        ranges = scan.ranges.astype(np.float64)
        valid = (ranges > 0.0) & (self._config.no_return_passes | (ranges < scan.max_range))
        returned = ranges[valid] < scan.max_range
        reach = np.minimum(ranges[valid], scan.max_range)
        angles = scan.bearings[valid] + T_world_laser.theta
        ends = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1) + T_world_laser.position
        fitted = (T_world_robot @ walls).reshape(-1, 2) if self._config.walls else np.empty((0, 2))
        points = np.concatenate([T_world_laser.position[None], ends, fitted])
        if not np.isfinite(points).all():
            raise ValueError("scan: found a pose or a wall that is not finite, allowed: finite numbers")
        cells = np.floor(points / self._config.cell_m)[:, ::-1]
        before = self._box
        self._grow(cells)
        local = cells.astype(np.int64) - self._tiles.first
        exact = points[1:, ::-1] / self._config.cell_m - self._tiles.first - 0.5
        walls_at, ends_at = local[1 + len(ends) :], local[1 : 1 + len(ends)]
        touched = ScanCells(local[0], ends_at, returned, walls_at, exact[: len(ends)], exact[len(ends) :])
        low, high = local.min(axis=0), local.max(axis=0)
        (top, left), (bottom, right) = (low - self._reach) // TILE, (high + self._reach) // TILE + 1
        squares = np.zeros((bottom - top, right - left), dtype=np.bool_)
        touched_squares(touched, self._reach, (int(top), int(left)), squares)
        try:
            self._allocate(self._tiles.lacking(squares, (int(top), int(left))))
        except InputError:
            self._box = before
            raise
        box = box_of(np.stack([low, high]) + np.array(self._tiles.first))
        self.changes.add(box)
        if self._scans == SCANS_PER_STAMP:
            self._cells.stamp[:], self._scans = 0, 0
        self._scans += 1
        count_scan(self._cells, self._tiles.index, touched, self._scans, self._offsets, self._rules)
        return box

    def submap(self) -> Submap:
        """The evidence of this grid, to compose another one."""
        return submap_of(self._cells, self._tiles)

    def compose(self, submaps: Sequence[Submap]) -> None:
        """Replace all evidence by that of submaps in the order of their scans."""
        self.clear()
        boxes = [submap.box for submap in submaps if len(submap.cells)]
        if boxes:
            self.recompose(submaps, boxes)

    def recompose(self, submaps: Sequence[Submap], boxes: Sequence[Box]) -> None:
        """Replace the evidence in the tiles that boxes touch by that of submaps in the order of their scans."""
        self._grow(np.array([corner for box in boxes for corner in box.corners]))
        touched = self._tiles.touched_by(boxes)
        erase(self._cells, self._tiles.index, self._tiles.among(touched), self._offsets)
        for submap in (whole.within(touched, self._tiles) for whole in submaps):
            places = self._make_room(submap.cells, submap.hits > 0)
            add_submap(self._cells, self._tiles.index, places, submap, self._rules)
        mark_obstacles(self._cells, self._tiles.index, self._tiles.among(touched), self._offsets, self._rules)
        for box in boxes:
            self.changes.add(box.aligned(TILE))

    def mark_seen(self, cells: NDArray[np.int64]) -> None:
        """Mark cells (N, 2), row, col from the world's origin, as seen."""
        if len(cells):
            self._grow(np.array([cells.min(axis=0), cells.max(axis=0)], dtype=np.float64))
            self.changes.add_all()
            places = self._make_room(cells, np.zeros(len(cells), dtype=np.bool_))
            self._cells.seen[self._tiles.slots(places)] = True

    def block_bodies(self, T_world_robot: Pose, standing_robot: Array, body_m: float) -> None:
        """Block the ways through bodies of a radius about returns (M, 2), robot's frame, in place of earlier ones.

        They are inflated as obstacles are, and are none: they are no evidence.
        """
        self._cover_bodies(-1)
        self._bodies = disc_cells(T_world_robot @ standing_robot, body_m, self._config.cell_m)
        self._cover_bodies(1)

    def _cover_bodies(self, count: int) -> None:
        """Add a count to the inflation of the bodies."""
        if len(self._bodies):
            self._grow(self._bodies.astype(np.float64))
            places = self._make_room(self._bodies, np.ones(len(self._bodies), dtype=np.bool_))
            covered = self._tiles.slots((places[:, None] + self._offsets[None]).ravel())
            np.add.at(self._cells.cover, covered, count)
            self.changes.add(box_of(self._bodies))

    def free_space(self, *points_world: ArrayLike) -> FreeSpace:
        """Where a robot may drive that keeps the clearance, with the given (2,) points covered."""
        from sixthsense.slam.mapping.clearance import Clearance

        clearance = Clearance(self._config.cell_m, self.inflation_m, self.inflation_m)
        clearance.update(self)
        return clearance.free_space(self.inflation_m).covering(*points_world)

    def obstacle_points(self, box: Box) -> Array:
        """(N, 2) where the obstacles in a box are, world frame, metres: the mean of each cell's returns."""
        rows, cols = np.nonzero(self.part("obstacles", box))
        down, across = (self.part(name, box)[rows, cols] / OFFSET for name in ("down", "across"))
        points = np.stack([box.left + cols + 0.5 + across, box.top + rows + 0.5 + down], axis=1)
        rows, cols = self._bodies.T
        inside = (rows >= box.top) & (rows < box.bottom) & (cols >= box.left) & (cols < box.right)
        points = np.concatenate([points, self._bodies[inside][:, ::-1] + 0.5])
        return np.asarray(points * self._config.cell_m)

    def part(self, name: CellField, box: Box) -> NDArray[Any]:
        """(H, W) what is kept of the cells in a box, 0 or False outside the grid."""
        return self._tiles.part(getattr(self._cells, name), box)

    @property
    def inflation_m(self) -> float:
        """From the centre of a free cell to the square of an obstacle cell, at least."""
        return self._inflation * self._config.cell_m

    @property
    def hits(self) -> Ints:
        """(H, W) scans that ended, or had a wall fitted, in the cell."""
        return self._whole("hits").astype(np.int32)

    @property
    def passes(self) -> Ints:
        """(H, W) scans that crossed the cell and did not hit it."""
        return self._whole("passes")

    def narrow(self, name: Literal["hits", "passes"]) -> NDArray[Any]:
        """(H, W) `hits` or `passes` in the smallest type that holds them: most of a large box was never seen."""
        counts = getattr(self._cells, name)
        self._check_size()
        return self._tiles.part(counts.astype(np.min_scalar_type(int(counts.max(initial=0)))), self._box)

    @property
    def seen(self) -> Bools:
        """(H, W) whether a beam has ever crossed the cell or ended in it: the sense grid, report section 4.5."""
        return self._whole("seen")

    @property
    def seen_area_m2(self) -> float:
        """Area of the cells that are seen."""
        return int(np.count_nonzero(self._cells.seen)) * self._config.cell_m**2

    @property
    def obstacles(self) -> Bools:
        """(H, W) cells whose evidence says occupied; not inflated."""
        return self._whole("obstacles")

    @property
    def box(self) -> Box:
        """The box of all cells that were seen, with their inflation and a rim, from the world's origin; it grows."""
        return self._box

    @property
    def origin(self) -> tuple[float, float]:
        """World x, y of the lower left corner of cell (0, 0), metres; it moves when the grid grows."""
        return self._box.left * self._config.cell_m, self._box.top * self._config.cell_m

    def occupancy(self) -> NDArray[np.int8]:
        """(H, W) as a map server has it: 0 seen and free, 100 obstacle, -1 unknown."""
        cells = self._cells.seen.astype(np.int8)
        cells[self._cells.obstacles] = 101
        self._check_size()
        occupancy = self._tiles.part(cells, self._box)
        occupancy -= 1  # in place: there may be many more cells than were seen
        return occupancy

    def _no_cells(self, most_hits: int) -> Cells:
        # An obstacle and a body may be in each cell of the stencil.
        return Cells.empty(0, most_hits, 2 * len(self._stencil))

    def _whole_masks(self) -> Masks:
        """Seen cells and inflation of the whole map; kept, and made again where it has changed."""
        self._check_size()
        box, old, revision = self._box, self._masks, self.changes.revision
        if old is not None and (old.box, old.revision) == (box, revision):
            return old
        since = self.changes.since(old.revision) if old is not None and old.box == box else None
        if old is None or since is None:
            seen, covered = self.part("seen", box), self.part("cover", box) > 0
        else:
            rows, cols = since.grown(self._reach).within((box.top, box.left), old.seen.shape)
            changed = Box(box.top + rows.start, box.left + cols.start, box.top + rows.stop, box.left + cols.stop)
            seen, covered = old.seen.copy(), old.covered.copy()
            seen[rows, cols], covered[rows, cols] = self.part("seen", changed), self.part("cover", changed) > 0
        seen.flags.writeable = covered.flags.writeable = False
        self._masks = Masks(box, revision, seen, covered)
        return self._masks

    def _whole(self, name: Literal["hits", "passes", "cover", "seen", "obstacles"]) -> NDArray[Any]:
        """(H, W) what is kept of all cells; InputError if they are more than 100 million."""
        self._check_size()
        return self.part(name, self._box)

    def _check_size(self) -> None:
        box = self._box
        cell_box(np.array([box.top, box.left], dtype=np.float64), np.array([box.bottom, box.right], dtype=np.float64))

    def _make_room(self, cells: NDArray[np.int64], hit: Bools) -> Places:
        """(N,) the places of cells (N, 2) within the box, with tiles for them and for the inflation of those hit."""
        places = self._tiles.places(cells)
        squares = self._tiles.around(places, 0) | self._tiles.around(places[hit], self._reach)
        self._allocate(self._tiles.lacking(squares, (0, 0)))
        return places

    def _allocate(self, new: NDArray[np.int64]) -> None:
        """Make room for the cells in squares (N, 2) that have no tile; InputError if there are too many."""
        count = (len(self._tiles.squares) + len(new)) * TILE * TILE
        if count > MAX_CELLS:
            raise InputError("grid", f"found {count:,} cells that were seen", f"at most {MAX_CELLS:,} cells")
        self._tiles.allocate(new)
        if count > len(self._cells.hits):
            self._cells.extend(max(count, len(self._cells.hits) * 5 // 4))

    def _grow(self, cells: Array) -> None:
        """Make room for (N, 2) cells (row, col from the world's origin), their inflation and a rim of free cells."""
        margin = 1.0 + float(self._reach)
        self._box = grown_box(self._box, cells.min(axis=0) - margin, cells.max(axis=0) + margin + 1.0)
        self._tiles.cover(self._box)
