"""The hit grid and the sense grid (report sections 4.4 and 4.5): evidence per cell, and inflation.

Cells are aligned to multiples of `cell_m` in the world, and indexed [row = y, col = x].
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.freespace import MAX_CELLS, TOUCH, Bools, FreeSpace, cell_box

__all__ = ["FreeSpace", "Grid", "line_cells"]

CHUNK = 64
"""The grid grows by at least this many cells on a side."""

Ints = NDArray[np.int32]


def line_cells(r0: int, c0: int, r1: int, c1: int) -> NDArray[np.int64]:
    """The (N, 2) cells (row, col) of Bresenham's line from (r0, c0) to (r1, c1), both ends included."""
    width = abs(c1 - c0) + 1
    cells = np.empty(max(abs(r1 - r0), width - 1) + 1, dtype=np.int64)
    row, col = min(r0, r1), min(c0, c1)
    _line(r0 - row, c0 - col, r1 - row, c1 - col, width, cells)
    return np.stack([cells // width + row, cells % width + col], axis=1)


MOST_REACH = 1000  # cells of inflation; a disc of more takes longer to draw than a robot to drive


class Grid:
    """Hit grid and sense grid in one: counts hits and passes per cell, grows as the robot sees.

    Evidence is counted once per scan: in one scan a cell gains at most one hit and one pass, and a hit beats a pass,
    so that beams grazing along a wall do not erase it. A cell is an obstacle when it has at least `min_hits` hits and
    at most `passes_per_hit` passes per hit, so that a stray return does not block for ever. A hit makes an obstacle at
    once, however long the cell has been free: of earlier passes no more are kept than it takes to just not undo it.
    Hits beyond `max_hits` are not kept either, so that a wall that was drawn in the wrong place can go.

    Obstacles are inflated by the robot's true disc: a cell is blocked when a disc of `radius_m` + `clearance_m` about
    its centre touches the square of an obstacle cell. A robot anywhere else in a cell that is not blocked is at most
    0.71 cells from the centre, which a clearance of that much absorbs.
    """

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Begin with an empty grid for a robot that is a disc of `radius_m`; ValueError if that is negative."""
        if not (math.isfinite(radius_m) and radius_m >= 0.0):
            raise ValueError(f"radius_m: found {radius_m}, allowed: at least 0")
        self._config = config
        reach = (radius_m + config.clearance_m) / config.cell_m
        _check_reach(reach)
        self._reach = reach
        self._stencil = _disc(reach)
        self.clear()

    def clear(self) -> None:
        """Forget everything, to build the grid anew from stored scans."""
        self._first = (0, 0)  # row, col of the array's corner, counted from the world's origin
        self._scans = 0
        self._hits, self._passes, self._cover, self._stamp = (np.zeros((0, 0), dtype=np.int32) for _ in range(4))
        self._seen, self._obstacles = (np.zeros((0, 0), dtype=np.bool_) for _ in range(2))
        self._flat_stencil = np.zeros(0, dtype=np.int64)

    def add(self, T_world_robot: Pose, scan: Scan, walls_robot: Array) -> None:
        """Count one scan taken at `T_world_robot`, and the (W, 2, 2) wall segments (robot frame, metres) fitted to it.

        A beam that returned hits the cell of its end and passes those before it; one without a return (at or beyond
        the scan's maximum) passes all up to the maximum, or none if so configured; a NaN, zero or negative range is no
        evidence. Raises
        ValueError for walls of another shape, for a pose, walls or maximum that are not finite, and when the grid
        would grow beyond 100 million cells; the grid is then unchanged.
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
        _add(
            self._hits, self._passes, self._seen, self._obstacles, self._cover, self._stamp, self._flat_stencil,
            local[0], local[1 : 1 + len(ends)], returned, local[1 + len(ends) :],
            self._scans, self._config.min_hits, self._config.max_hits, self._config.passes_per_hit,
        )  # fmt: skip

    def free_space(self, *points_world: ArrayLike, margin_m: float = 0.0) -> FreeSpace:
        """A snapshot that covers all that was seen, a free rim around it, and the given (2,) points.

        `margin_m` is added to the inflation, by the same discs; a negative one is taken off it, down to no inflation
        at all. A positive one gives way within `margin_m` of the points, so that a robot which stands that near an
        obstacle can leave it, and a goal there be reached. Raises ValueError for a margin of NaN
        or inf, InputError for an inflation of more than 1000 cells.
        """
        space = FreeSpace(self._cover > 0, self._seen, self.origin, self._config.cell_m)
        if margin_m == 0.0:
            return space.covering(*points_world)
        if not margin_m < math.inf:
            raise ValueError(f"margin_m: found {margin_m}, allowed: a finite number")
        cell_m = self._config.cell_m
        reach = max(self._reach + margin_m / cell_m, 0.0)
        _check_reach(reach)
        stencil = _disc(reach)
        rim = max(int(stencil.max(initial=0)) - int(self._stencil.max()), 0)
        blocked, seen = np.pad(self._obstacles, rim), np.pad(self._seen, rim)
        width = blocked.shape[1]
        _stamp_discs(np.flatnonzero(blocked), stencil[:, 0] * width + stencil[:, 1], blocked)
        origin = self.origin[0] - rim * cell_m, self.origin[1] - rim * cell_m
        wide = FreeSpace(blocked, seen, origin, cell_m).covering(*points_world)
        if margin_m < 0.0 or not points_world:
            return wide
        blocked = wide.blocked.copy()
        narrow = space.covering(*points_world)
        for point in points_world:
            _give_way(blocked, narrow, wide, point, margin_m)
        return FreeSpace(blocked, wide.seen, wide.origin, cell_m)

    @property
    def hits(self) -> Ints:
        """(H, W) scans that ended, or had a wall fitted, in the cell."""
        return self._hits.copy()

    @property
    def passes(self) -> Ints:
        """(H, W) scans that crossed the cell and did not hit it."""
        return self._passes.copy()

    @property
    def seen(self) -> Bools:
        """(H, W) whether a beam has ever crossed the cell or ended in it: the sense grid, report section 4.5."""
        return self._seen.copy()

    @property
    def obstacles(self) -> Bools:
        """(H, W) cells whose evidence says occupied; not inflated."""
        return self._obstacles.copy()

    @property
    def origin(self) -> tuple[float, float]:
        """World x, y of the lower left corner of cell (0, 0), metres; it moves when the grid grows."""
        return self._first[1] * self._config.cell_m, self._first[0] * self._config.cell_m

    def occupancy(self) -> NDArray[np.int8]:
        """(H, W) as a map server has it: 0 seen and free, 100 obstacle, -1 unknown."""
        return np.where(self._obstacles, 100, np.where(self._seen, 0, -1)).astype(np.int8)

    def _grow(self, cells: Array) -> None:
        """Make room for (N, 2) cells (row, col from the world's origin), their inflation and a rim of free cells."""
        margin = 1.0 + float(self._stencil.max())
        low, high = cells.min(axis=0) - margin, cells.max(axis=0) + margin + 1.0
        old_low, old_high = np.full(2, np.inf), np.full(2, -np.inf)
        if self._hits.size:
            old_low, old_high = np.array(self._first, dtype=np.float64), np.add(self._first, self._hits.shape)
        if (low >= old_low).all() and (high <= old_high).all():
            return
        # A side that must move moves on by a quarter of the extent, so that all growth together costs O(cells).
        all_low, all_high = np.minimum(low, old_low), np.maximum(high, old_high)
        step = np.maximum(CHUNK, (all_high - all_low) // 4)
        roomy_low = np.where(low < old_low, low - step, old_low)
        roomy_high = np.where(high > old_high, high + step, old_high)
        low, high = all_low, all_high
        if np.prod(roomy_high - roomy_low) <= MAX_CELLS:
            low, high = roomy_low, roomy_high
        (row, col), (height, width) = cell_box(low, high)
        top, left = self._first[0] - row, self._first[1] - col
        place = slice(top, top + self._hits.shape[0]), slice(left, left + self._hits.shape[1])
        for name in ("_hits", "_passes", "_cover", "_stamp", "_seen", "_obstacles"):
            old: NDArray[Any] = getattr(self, name)
            grown = np.zeros((height, width), dtype=old.dtype)
            if old.size:
                grown[place] = old
            setattr(self, name, grown)
        self._first = (row, col)
        self._flat_stencil = self._stencil[:, 0] * width + self._stencil[:, 1]


def _check_reach(reach: float) -> None:
    if reach > MOST_REACH:
        raise InputError(f"grid: found an inflation of {reach:.0f} cells, allowed: at most {MOST_REACH}")


def _give_way(blocked: Bools, narrow: FreeSpace, wide: FreeSpace, point: ArrayLike, radius_m: float) -> None:
    """Set the cells of `blocked`, those of `wide`, whose centres lie within `radius_m` of a point as `narrow` has them.

    The point's own cell is among them; both spaces have the same cells, `wide` maybe more.
    """
    row, col = wide.cell_of(point)
    reach = math.ceil(radius_m / wide.cell_m) + 1
    height, width = wide.blocked.shape
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, height))
    cols = np.arange(max(col - reach, 0), min(col + reach + 1, width))
    x, y = wide.origin[0] + (cols + 0.5) * wide.cell_m, wide.origin[1] + (rows + 0.5) * wide.cell_m
    at = np.asarray(point, dtype=np.float64)
    near = np.hypot(x[None, :] - at[0], y[:, None] - at[1]) <= radius_m + wide.cell_m
    down, across = (round((wide.origin[k] - narrow.origin[k]) / wide.cell_m) for k in (1, 0))
    there = narrow.window(rows + down, cols + across)
    blocked[np.ix_(rows, cols)] &= there | ~near


@numba.njit(cache=True, error_model="numpy")
def _stamp_discs(cells: NDArray[np.int64], stencil: NDArray[np.int64], blocked2: Bools) -> None:
    """Block the `stencil` (K,) of flat offsets about each of the flat `cells` (N,); it must not leave the array."""
    blocked = blocked2.ravel()
    for cell in cells:
        for offset in stencil:
            blocked[cell + offset] = True


def _disc(radius: float) -> NDArray[np.int64]:
    """(K, 2) offsets (row, col) of the cells about whose centres a disc, in cells, touches the square at (0, 0)."""
    reach = math.floor(radius + 0.5 + TOUCH)
    offsets = np.arange(-reach, reach + 1)
    gap = np.maximum(np.abs(offsets) - 0.5, 0.0)
    return np.argwhere(np.hypot(gap[:, None], gap[None, :]) <= radius + TOUCH) - reach


@numba.njit(cache=True, error_model="numpy")
def _line(r0: int, c0: int, r1: int, c1: int, width: int, cells: NDArray[np.int64]) -> int:
    """Fill `cells` with the flat indices, row * `width` + col, of Bresenham's line; returns how many."""
    down, across = abs(r1 - r0), abs(c1 - c0)
    row_step, col_step = width if r1 > r0 else -width, 1 if c1 > c0 else -1
    major, minor, major_step, minor_step = across, down, col_step, row_step
    if down > across:
        major, minor, major_step, minor_step = down, across, row_step, col_step
    cell, error = r0 * width + c0, major // 2
    for k in range(major + 1):
        cells[k] = cell
        cell += major_step
        error -= minor
        if error < 0:
            cell += minor_step
            error += major
    return major + 1


@numba.njit(cache=True, error_model="numpy")
def _hit(
    cell: int, mark: int, hits: Ints, passes: Ints, obstacles: Bools, cover: Ints, stamp: Ints,
    stencil: NDArray[np.int64], min_hits: int, max_hits: int, passes_per_hit: float,
) -> None:  # fmt: skip
    """Count a hit, once per scan, and inflate the cell if that makes it an obstacle; all arrays flat."""
    if stamp[cell] == mark:
        return
    stamp[cell] = mark
    hits[cell] = min(hits[cell] + 1, max_hits)
    # However long a cell has been free: a robot that sees an obstacle there now must not run into it.
    passes[cell] = min(passes[cell], int(passes_per_hit * hits[cell]))
    if not obstacles[cell] and hits[cell] >= min_hits:
        obstacles[cell] = True
        for offset in stencil:
            cover[cell + offset] += 1


@numba.njit(cache=True, error_model="numpy")
def _add(
    hits2: Ints, passes2: Ints, seen2: Bools, obstacles2: Bools, cover2: Ints, stamp2: Ints,
    stencil: NDArray[np.int64], laser: NDArray[np.int64], ends: NDArray[np.int64], returned: Bools,
    walls: NDArray[np.int64], scan: int, min_hits: int, max_hits: int, passes_per_hit: float,
) -> None:  # fmt: skip
    """Count one scan: cells (row, col) of the laser (2,), of the beams' ends (N, 2), of the walls' ends (2 W, 2)."""
    hits, passes, seen, obstacles = hits2.ravel(), passes2.ravel(), seen2.ravel(), obstacles2.ravel()
    cover, stamp = cover2.ravel(), stamp2.ravel()
    height, width = hits2.shape
    line = np.empty(max(height, width), dtype=np.int64)
    passed, hit = 2 * scan, 2 * scan + 1  # the marks by which a cell knows what this scan did to it
    for i in range(len(ends)):
        cell = ends[i, 0] * width + ends[i, 1]
        seen[cell] = True
        if returned[i]:
            _hit(cell, hit, hits, passes, obstacles, cover, stamp, stencil, min_hits, max_hits, passes_per_hit)
    for j in range(0, len(walls), 2):
        for k in range(_line(walls[j, 0], walls[j, 1], walls[j + 1, 0], walls[j + 1, 1], width, line)):
            _hit(line[k], hit, hits, passes, obstacles, cover, stamp, stencil, min_hits, max_hits, passes_per_hit)
    for i in range(len(ends)):
        count = _line(laser[0], laser[1], ends[i, 0], ends[i, 1], width, line)
        for k in range(count - 1 if returned[i] else count):
            cell = line[k]
            if stamp[cell] == passed:
                continue
            seen[cell] = True
            if stamp[cell] == hit:
                continue
            stamp[cell] = passed
            passes[cell] += 1
            if obstacles[cell] and passes[cell] > passes_per_hit * hits[cell]:
                obstacles[cell] = False
                for offset in stencil:
                    cover[cell + offset] -= 1
