"""Free space of the robot's centre: a snapshot of the inflated grid, with the queries of planning."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import cell_box

TOUCH = 1e-9
"""Tolerance of geometric tests, in cells: a corner that is just touched counts as touched."""

Bools = NDArray[np.bool_]


def as_point(name: str, value: ArrayLike) -> Array:
    """`value` as a (2,) float64 array; ValueError naming it for another shape, NaN or infinity."""
    point = np.array(value, dtype=np.float64)
    if point.shape != (2,):
        raise ValueError(f"{name}: expected shape (2,), got {point.shape}")
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        raise ValueError(f"{name}: found ({point[0]}, {point[1]}), allowed: finite numbers")
    return point


class Ellipse(NamedTuple):
    """Where paths of a bounded length between two points lie."""

    a: Array
    """(2,) world frame, metres"""
    b: Array
    """(2,) likewise"""
    length_m: float
    """of the longest path"""

    def rows_and_cols(self, shape: tuple[int, ...], origin: tuple[float, float], cell_m: float) -> tuple[slice, slice]:
        """The rows and columns that hold it, of cells (H, W) whose lower left corner is `origin`."""
        middle = (0.5 * (self.a + self.b) - origin) / cell_m
        reach = 0.5 * self.length_m / cell_m + 2.0
        low, high = (
            np.clip(np.nan_to_num(end), 0, shape[::-1]).astype(int) for end in (middle - reach, middle + reach)
        )
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def block_beyond(self, blocked: Bools, origin: tuple[float, float], cell_m: float) -> None:
        """Block the cells of (H, W) `blocked` outside it; the lower left corner of the cells is `origin`."""
        rows, cols = self.rows_and_cols(blocked.shape, origin, cell_m)
        inside = blocked[rows, cols].copy()
        (ax, ay), (bx, by) = (((point - origin) / cell_m).tolist() for point in (self.a, self.b))
        _block_beyond(inside, (rows.start, cols.start), (ax, ay, bx, by), self.length_m / cell_m + 2.0)
        blocked.fill(True)
        blocked[rows, cols] = inside


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """A snapshot of the cells where the robot's centre may be; cells outside it are unknown, and unknown is free."""

    blocked: Bools
    """(H, W), read-only: a robot at the cell's centre would touch an obstacle"""
    seen: Bools
    """(H, W), read-only: a beam has crossed the cell"""
    origin: tuple[float, float]
    """world x, y of the lower left corner of cell (0, 0), metres"""
    cell_m: float
    """side of a cell, metres"""

    def __post_init__(self) -> None:
        for name in ("blocked", "seen"):
            array = frozen(getattr(self, name))
            if array.ndim != 2 or array.shape != np.shape(self.blocked):
                raise ValueError(f"{name}: expected shape (H, W) alike in blocked and seen, got {array.shape}")
            object.__setattr__(self, name, array)

    def cell_of(self, point_world: ArrayLike) -> tuple[int, int]:
        """The (row, col) of the cell that holds a (2,) point, which may lie outside the grid."""
        x, y = self._in_cells("point", point_world)
        return math.floor(y), math.floor(x)

    def centre(self, row: int, col: int) -> Array:
        """(2,) world coordinates of a cell's centre, metres."""
        return np.array([self.origin[0] + (col + 0.5) * self.cell_m, self.origin[1] + (row + 0.5) * self.cell_m])

    def contains(self, point_world: ArrayLike) -> bool:
        """Whether the grid covers a (2,) point."""
        row, col = self.cell_of(point_world)
        height, width = self.blocked.shape
        return bool(0 <= row < height and 0 <= col < width)

    def is_blocked(self, point_world: ArrayLike) -> bool:
        """Whether a (2,) point lies in a blocked cell."""
        row, col = self.cell_of(point_world)
        height, width = self.blocked.shape
        return bool(0 <= row < height and 0 <= col < width and self.blocked[row, col])

    def line_is_free(self, a_world: ArrayLike, b_world: ArrayLike) -> bool:
        """Whether no blocked cell is touched, not even at a corner, by the segment between two (2,) points.

        A segment within one cell touches that one alone: a point on an edge lies where `cell_of` says.
        """
        x0, y0 = self._in_cells("a", a_world)
        x1, y1 = self._in_cells("b", b_world)
        return not bool(line_touches(self.blocked, x0, y0, x1, y1))

    def in_cells(self, points_world: Array) -> Array:
        """The points (..., 2) in cells from the grid's corner, x and y."""
        return np.asarray((points_world - np.array(self.origin)) / self.cell_m)

    def window(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Bools:
        """(R, C) whether the cells of these rows and columns are blocked; those outside the grid are not."""
        height, width = self.blocked.shape
        inside_rows, inside_cols = (rows >= 0) & (rows < height), (cols >= 0) & (cols < width)
        blocked = np.zeros((len(rows), len(cols)), dtype=np.bool_)
        blocked[np.ix_(inside_rows, inside_cols)] = self.blocked[np.ix_(rows[inside_rows], cols[inside_cols])]
        return blocked

    def nearest_free(self, point_world: ArrayLike, within_m: float) -> Array | None:
        """The point itself if free, else the nearest free cell's centre at most `within_m` away, else None."""
        point = as_point("point", point_world)
        if not self.is_blocked(point):
            return point
        height, width = self.blocked.shape
        row, col = self.cell_of(point)
        reach = math.ceil(min(within_m / self.cell_m, max(height, width))) + 1
        rows, cols = np.arange(row - reach, row + reach + 1), np.arange(col - reach, col + reach + 1)
        blocked = self.window(rows, cols)
        x = self.origin[0] + (cols + 0.5) * self.cell_m - point[0]
        y = self.origin[1] + (rows + 0.5) * self.cell_m - point[1]
        distance = np.where(blocked, np.inf, np.hypot(x[None, :], y[:, None]))
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        return self.centre(int(rows[i]), int(cols[j])) if distance[i, j] <= within_m else None

    def covering(self, *points_world: ArrayLike) -> FreeSpace:
        """Extend by unknown cells where needed to cover all the given (2,) points.

        Raises ValueError when that would take more than 100 million cells.
        """
        points = [as_point("point", point) for point in points_world]
        if not points or (self.blocked.size and all(self.contains(point) for point in points)):
            return self
        cells = np.floor((np.array(points) - self.origin) / self.cell_m)[:, ::-1]
        low, high = cells.min(axis=0) - 1.0, cells.max(axis=0) + 2.0
        if self.blocked.size:
            low, high = np.minimum(low, 0.0), np.maximum(high, self.blocked.shape)
        (row, col), (height, width) = cell_box(low, high)
        blocked, seen = (np.zeros((height, width), dtype=np.bool_) for _ in range(2))
        place = slice(-row, -row + self.blocked.shape[0]), slice(-col, -col + self.blocked.shape[1])
        if self.blocked.size:
            blocked[place], seen[place] = self.blocked, self.seen
        origin = self.origin[0] + col * self.cell_m, self.origin[1] + row * self.cell_m
        return FreeSpace(blocked, seen, origin, self.cell_m)

    def between(self, within: Ellipse) -> FreeSpace:
        """The same with all cells blocked outside an ellipse."""
        blocked = self.blocked.copy()
        within.block_beyond(blocked, self.origin, self.cell_m)
        return FreeSpace(blocked, self.seen, self.origin, self.cell_m)

    def _in_cells(self, name: str, point_world: ArrayLike) -> tuple[float, float]:
        """X and y of a point in cells from the grid's corner."""
        x, y = as_point(name, point_world)
        return float((x - self.origin[0]) / self.cell_m), float((y - self.origin[1]) / self.cell_m)


def frozen(mask: Bools) -> Bools:
    """The mask as a read-only one: a copy, unless nobody else can write to it."""
    if isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.base is None and not mask.flags.writeable:
        return mask
    array = np.array(mask, dtype=np.bool_)
    array.flags.writeable = False
    return array


@numba.njit(cache=True, error_model="numpy")
def _block_beyond(
    blocked: Bools, first: tuple[int, int], ends: tuple[float, float, float, float], length: float
) -> None:
    """Block the cells whose centres' distances from two points, `ends`, add up to more than `length`; all in cells.

    `first` is the row and column of the first of the cells.
    """
    ax, ay, bx, by = ends
    height, width = blocked.shape
    for row in range(height):
        down_a, down_b = row + first[0] + 0.5 - ay, row + first[0] + 0.5 - by
        for col in range(width):
            if not blocked[row, col]:
                x = col + first[1] + 0.5
                far = math.sqrt(down_a * down_a + (x - ax) ** 2) + math.sqrt(down_b * down_b + (x - bx) ** 2)
                blocked[row, col] = far > length


@numba.njit(cache=True, error_model="numpy")
def line_touches(grid: Bools, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Supercover walk: column by column, all rows that the part of the segment within the column reaches."""
    height, width = grid.shape
    if x1 < x0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    # Within one cell no other is touched, even along its edge: so a point on an edge is in the cell of `cell_of`.
    touch = 0.0 if np.floor(x0) == np.floor(x1) and np.floor(y0) == np.floor(y1) else TOUCH
    first, last = min(max(np.floor(x0 - touch), 0.0), width), max(min(np.floor(x1 + touch), width - 1.0), -1.0)
    for col in range(int(first), int(last) + 1):
        enter, leave = 0.0, 1.0
        if x1 > x0:
            enter = min(max((col - touch - x0) / (x1 - x0), 0.0), 1.0)
            leave = min(max((col + 1 + touch - x0) / (x1 - x0), 0.0), 1.0)
        ya, yb = y0 + enter * (y1 - y0), y0 + leave * (y1 - y0)
        low, high = np.floor(min(ya, yb) - touch), np.floor(max(ya, yb) + touch)
        for row in range(int(min(max(low, 0.0), height)), int(max(min(high, height - 1.0), -1.0)) + 1):
            if grid[row, col]:
                return True
    return False


class Ray(NamedTuple):
    """A ray on its way from cell to cell, in cells (Amanatides and Woo, Eurographics 1987)."""

    row: int
    col: int
    row_step: int
    col_step: int
    per_row: float
    """length of the ray from one edge between rows to the next; infinite along these edges"""
    per_col: float
    next_row: float
    """length from the ray's begin to the next edge between rows"""
    next_col: float
    gone: float
    """length from the ray's begin to where it has entered its cell"""


@numba.njit(cache=True, error_model="numpy")
def ray_from(x: float, y: float, c: float, s: float) -> Ray:
    """The ray from a point (column and row as real numbers) in a direction, cosine and sine."""
    row, col = math.floor(y), math.floor(x)
    per_row, per_col = abs(1.0 / s), abs(1.0 / c)
    next_row = per_row * (row + 1 - y if s > 0.0 else y - row) if s != 0.0 else math.inf
    next_col = per_col * (col + 1 - x if c > 0.0 else x - col) if c != 0.0 else math.inf
    return Ray(row, col, 1 if s > 0.0 else -1, 1 if c > 0.0 else -1, per_row, per_col, next_row, next_col, 0.0)


@numba.njit(cache=True, error_model="numpy")
def ahead(ray: Ray) -> Ray:
    """The same in its next cell."""
    row, col, row_step, col_step, per_row, per_col, next_row, next_col, _ = ray
    if next_col < next_row:
        return Ray(row, col + col_step, row_step, col_step, per_row, per_col, next_row, next_col + per_col, next_col)
    return Ray(row + row_step, col, row_step, col_step, per_row, per_col, next_row + per_row, next_col, next_row)
