"""The hit grid and the sense grid (report sections 4.4 and 4.5): evidence per cell, and inflation.

Cells are aligned to multiples of `cell_m` in the world, and indexed [row = y, col = x].
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.evidence import Cells, EvidenceRules, Ints, ScanCells, count_scan, line_cells
from sixthsense.slam.mapping.freespace import MAX_CELLS, Bools, FreeSpace, cell_box
from sixthsense.slam.mapping.inflation import check_inflation, disc, give_way, stamp_discs
from sixthsense.slam.mapping.submap import Submap, add_submap, mark_obstacles, submap_of

__all__ = ["FreeSpace", "Grid", "line_cells"]

MIN_GROWTH = 64
"""The grid grows by at least this many cells on a side."""


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
        self.clear()

    def clear(self) -> None:
        """Remove all evidence, to rebuild the grid from stored scans."""
        self._first = (0, 0)  # row, col of the array's corner, counted from the world's origin
        self._scans = 0
        self._cells = Cells.empty(0, 0)
        self._flat_stencil = np.zeros(0, dtype=np.int64)

    def add(self, T_world_robot: Pose, scan: Scan, walls_robot: Array) -> None:
        """Count one scan taken at `T_world_robot`, and the (W, 2, 2) wall segments (robot frame, metres) fitted to it.

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
        self._grow(cells)
        local = cells.astype(np.int64) - self._first
        self._scans += 1
        touched = ScanCells(local[0], local[1 : 1 + len(ends)], returned, local[1 + len(ends) :])
        count_scan(self._cells, touched, self._scans, self._flat_stencil, self._rules)

    def submap(self) -> Submap:
        """The evidence of this grid, to compose another one."""
        return submap_of(self._counted(), self._first)

    def compose(self, submaps: Sequence[Submap]) -> None:
        """Replace all evidence by that of submaps in the order of their scans."""
        self.clear()
        corners = np.concatenate([np.zeros((0, 2)), *(submap.corners for submap in submaps)])
        if len(corners) == 0:
            return
        self._grow(corners)
        for submap in submaps:
            add_submap(self._cells, self._first, submap, self._rules)
        mark_obstacles(self._cells, self._flat_stencil, self._rules)

    def mark_seen(self, cells: NDArray[np.int64]) -> None:
        """Mark cells (N, 2), row, col from the world's origin, as seen."""
        if len(cells):
            self._grow(np.array([cells.min(axis=0), cells.max(axis=0)], dtype=np.float64))
            rows, cols = (cells - self._first).T
            self._cells.seen[rows, cols] = True

    def free_space(self, *points_world: ArrayLike, margin_m: float = 0.0) -> FreeSpace:
        """A snapshot that covers all that was seen, a free rim around it, and the given (2,) points.

        `margin_m` is added to the inflation. A negative one reduces it, down to no inflation. A positive one gives way
        within `margin_m` of the points, so that a robot that near an obstacle can leave it, and a goal there can be
        reached. Raises ValueError for a margin of NaN or inf, InputError for an inflation of more than 1000 cells.
        """
        cells = self._counted()
        covered = cells.cover > 0
        covered.flags.writeable = False
        space = FreeSpace(covered, cells.seen, self.origin, self._config.cell_m)
        if margin_m == 0.0:
            return space.covering(*points_world)
        if not margin_m < math.inf:
            raise ValueError(f"margin_m: found {margin_m}, allowed: a finite number")
        cell_m = self._config.cell_m
        inflation = max(self._inflation + margin_m / cell_m, 0.0)
        check_inflation(inflation)
        stencil = disc(inflation)
        rim = max(int(stencil.max(initial=0)) - int(self._stencil.max()), 0)
        blocked, seen = np.pad(cells.obstacles, rim), np.pad(cells.seen, rim)
        width = blocked.shape[1]
        stamp_discs(np.flatnonzero(blocked), stencil[:, 0] * width + stencil[:, 1], blocked)
        origin = self.origin[0] - rim * cell_m, self.origin[1] - rim * cell_m
        wide = FreeSpace(blocked, seen, origin, cell_m).covering(*points_world)
        if margin_m < 0.0 or not points_world:
            return wide
        blocked = wide.blocked.copy()
        narrow = space.covering(*points_world)
        for point in points_world:
            give_way(blocked, narrow, wide, point, margin_m)
        return FreeSpace(blocked, wide.seen, wide.origin, cell_m)

    @property
    def hits(self) -> Ints:
        """(H, W) scans that ended, or had a wall fitted, in the cell."""
        return self._counted().hits.copy()

    @property
    def passes(self) -> Ints:
        """(H, W) scans that crossed the cell and did not hit it."""
        return self._counted().passes.copy()

    @property
    def seen(self) -> Bools:
        """(H, W) whether a beam has ever crossed the cell or ended in it: the sense grid, report section 4.5."""
        return self._counted().seen.copy()

    @property
    def obstacles(self) -> Bools:
        """(H, W) cells whose evidence says occupied; not inflated."""
        return self._counted().obstacles.copy()

    @property
    def origin(self) -> tuple[float, float]:
        """World x, y of the lower left corner of cell (0, 0), metres; it moves when the grid grows."""
        self._counted()
        return self._first[1] * self._config.cell_m, self._first[0] * self._config.cell_m

    def occupancy(self) -> NDArray[np.int8]:
        """(H, W) as a map server has it: 0 seen and free, 100 obstacle, -1 unknown."""
        cells = self._counted()
        return np.where(cells.obstacles, 100, np.where(cells.seen, 0, -1)).astype(np.int8)

    def _counted(self) -> Cells:
        """The cells for a reader; a subclass may count what is due before."""
        return self._cells

    def _grow(self, cells: Array) -> None:
        """Make room for (N, 2) cells (row, col from the world's origin), their inflation and a rim of free cells."""
        margin = 1.0 + float(self._stencil.max())
        low, high = cells.min(axis=0) - margin, cells.max(axis=0) + margin + 1.0
        old_low, old_high = np.full(2, np.inf), np.full(2, -np.inf)
        if self._cells.hits.size:
            old_low, old_high = np.array(self._first, dtype=np.float64), np.add(self._first, self._cells.hits.shape)
        if (low >= old_low).all() and (high <= old_high).all():
            return
        # A side that must move moves by at least a quarter of the extent, so that all growth together costs O(cells).
        all_low, all_high = np.minimum(low, old_low), np.maximum(high, old_high)
        step = np.maximum(MIN_GROWTH, (all_high - all_low) // 4)
        roomy_low = np.where(low < old_low, low - step, old_low)
        roomy_high = np.where(high > old_high, high + step, old_high)
        low, high = all_low, all_high
        if np.prod(roomy_high - roomy_low) <= MAX_CELLS:
            low, high = roomy_low, roomy_high
        (row, col), (height, width) = cell_box(low, high)
        top, left = self._first[0] - row, self._first[1] - col
        self._cells = self._cells.grown(height, width, top, left)
        self._first = (row, col)
        self._flat_stencil = self._stencil[:, 0] * width + self._stencil[:, 1]
