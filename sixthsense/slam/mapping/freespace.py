"""Free space of the robot's centre: a snapshot of the inflated grid, with the queries of planning."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import Box, cell_box, moved

TOUCH = 1e-9
"""Tolerance of geometric tests, in cells: a corner that is just touched counts as touched."""

Bools = NDArray[np.bool_]
Floats = NDArray[np.float32]


def as_point(name: str, value: ArrayLike) -> Array:
    """`value` as a (2,) float64 array; ValueError naming it for another shape, NaN or infinity."""
    point = np.array(value, dtype=np.float64)
    if point.shape != (2,):
        raise ValueError(f"{name}: expected shape (2,), got {point.shape}")
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        raise ValueError(f"{name}: found ({point[0]}, {point[1]}), allowed: finite numbers")
    return point


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """A snapshot of the cells where the robot's centre may be, and of what a way through them costs.

    Cells outside it are unknown, and unknown is free. All arrays are read-only.
    """

    blocked: Bools
    """(H, W) the robot would be too near to an obstacle, wherever it is in the cell"""
    seen: Bools
    """(H, W) a beam has crossed the cell"""
    origin: tuple[float, float]
    """world x, y of the lower left corner of cell (0, 0), metres"""
    cell_m: float
    """side of a cell, metres"""
    cost: Floats = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32))
    """(H, W) of a metre of way, at least 1, and inf where it is blocked; by default 1 wherever it is free"""
    offsets: Floats = field(default_factory=lambda: np.zeros((0, 0, 2), dtype=np.float32))
    """(H, W, 2) row and col, in cells, from a cell's centre to where a way leads through it; 0 but in narrow gaps"""

    def __post_init__(self) -> None:
        shape = np.shape(self.blocked)
        if not self.cost.size:
            object.__setattr__(self, "cost", np.where(self.blocked, np.inf, 1.0).astype(np.float32))
        if not self.offsets.size:
            object.__setattr__(self, "offsets", np.zeros((*shape, 2), dtype=np.float32))
        kinds = {"blocked": np.bool_, "seen": np.bool_, "cost": np.float32, "offsets": np.float32}
        for name, kind in kinds.items():
            array = frozen(getattr(self, name), kind)
            if len(shape) != 2 or array.shape[:2] != shape:
                raise ValueError(f"{name}: expected shape (H, W) alike in all arrays, got {array.shape}")
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
        return self.contains(point_world) and bool(self.blocked[self.cell_of(point_world)])

    def line_is_free(self, a_world: ArrayLike, b_world: ArrayLike) -> bool:
        """Whether no blocked cell is touched, not even at a corner, by the segment between two (2,) points.

        A segment within one cell touches that one alone: a point on an edge lies where `cell_of` says.
        """
        x0, y0 = self._in_cells("a", a_world)
        x1, y1 = self._in_cells("b", b_world)
        return not bool(line_touches(self.blocked, x0, y0, x1, y1))

    def path_cost(self, path_world: Array) -> float:
        """The integral of the cost along (N, 2) way points, metres."""
        ends = self.in_cells(path_world).tolist()
        return self.cell_m * sum(line_cost(self.cost, *a, *b) for a, b in itertools.pairwise(ends))

    def in_cells(self, points_world: Array) -> Array:
        """The points (..., 2) in cells from the grid's corner, x and y."""
        return np.asarray((points_world - np.array(self.origin)) / self.cell_m)

    def nearest_free(self, point_world: ArrayLike, within_m: float) -> Array | None:
        """The point itself if free, else the nearest free cell's centre at most `within_m` away, else None."""
        point = as_point("point", point_world)
        if not self.is_blocked(point):
            return point
        space = self.covering(point - within_m, point + within_m)
        row, col = np.nonzero(~space.blocked)
        centres = np.array(space.origin) + (np.column_stack([col, row]) + 0.5) * self.cell_m
        away = np.linalg.norm(centres - point, axis=1)
        return centres[away.argmin()] if away.min(initial=np.inf) <= within_m else None

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
        before, box = Box(0, 0, *self.blocked.shape), Box(row, col, row + height, col + width)
        arrays = (self.blocked, False), (self.seen, False), (self.cost, 1.0), (self.offsets, 0.0)
        blocked, seen, cost, offsets = (moved(array, before, box, fill) for array, fill in arrays)
        origin = self.origin[0] + col * self.cell_m, self.origin[1] + row * self.cell_m
        return FreeSpace(blocked, seen, origin, self.cell_m, cost, offsets)

    def _in_cells(self, name: str, point_world: ArrayLike) -> tuple[float, float]:
        """X and y of a point in cells from the grid's corner."""
        x, y = as_point(name, point_world)
        return float((x - self.origin[0]) / self.cell_m), float((y - self.origin[1]) / self.cell_m)


def frozen(array: NDArray[Any], kind: type) -> NDArray[Any]:
    """The array as a read-only one: a copy, unless nobody else can write to it."""
    if isinstance(array, np.ndarray) and array.dtype == kind and array.base is None and not array.flags.writeable:
        return array
    copy: NDArray[Any] = np.array(array, dtype=kind)
    copy.flags.writeable = False
    return copy


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


@numba.njit(cache=True, error_model="numpy")
def line_cost(cost: Floats, x0: float, y0: float, x1: float, y1: float) -> float:
    """The integral of a cost (H, W) along a segment, in cells: by the middles of pieces of at most half a cell.

    Outside the cells the cost is 1.
    """
    height, width = cost.shape
    length = math.hypot(x1 - x0, y1 - y0)
    pieces = max(math.ceil(2.0 * length), 1)
    total = 0.0
    for k in range(pieces):
        share = (k + 0.5) / pieces
        row, col = math.floor(y0 + share * (y1 - y0)), math.floor(x0 + share * (x1 - x0))
        total += cost[row, col] if 0 <= row < height and 0 <= col < width else 1.0
    return total * length / pieces
