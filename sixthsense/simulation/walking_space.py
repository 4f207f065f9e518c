"""Where people walk in a building: its free cells, its rooms, shortest ways, and the walks that a scene states."""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Sequence
from typing import Annotated, Any, Self

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import ndimage

from sixthsense.config.errors import InputError
from sixthsense.config.section import Section
from sixthsense.core.geometry import Array
from sixthsense.simulation.scene_files import Coordinate, Region, read_each, read_section

BODY_M = 0.25
"""radius of the disc that a person's body is"""

Bools = NDArray[np.bool_]
Cells = NDArray[np.int64]

_MOST_WALKS = 200
_CELL_M = 0.1
# Rooms are what remains when all places as narrow are closed: doors, and corridors where people cannot pass each other.
_DOOR_M = 1.4
_STEPS = np.array([[0, 1], [1, 0], [0, -1], [-1, 0], [1, 1], [1, -1], [-1, -1], [-1, 1]])


@numba.njit(cache=True, error_model="numpy")
def mark_distances(walls: Array, x0: float, y0: float, cell_m: float, reach_m: float, away_m: Array) -> None:
    """Lower `away_m` (H, W) to the distance of each cell's centre from the nearest of `walls` (M, 4) within reach."""
    height, width = away_m.shape
    for j in range(walls.shape[0]):
        ax, ay, ex, ey = walls[j, 0], walls[j, 1], walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
        length_sq = max(ex * ex + ey * ey, 1e-300)
        left, right = min(ax, ax + ex) - reach_m, max(ax, ax + ex) + reach_m
        low, high = min(ay, ay + ey) - reach_m, max(ay, ay + ey) + reach_m
        for row in range(max(int((low - y0) / cell_m), 0), min(int((high - y0) / cell_m) + 1, height)):
            for col in range(max(int((left - x0) / cell_m), 0), min(int((right - x0) / cell_m) + 1, width)):
                px, py = x0 + (col + 0.5) * cell_m - ax, y0 + (row + 0.5) * cell_m - ay
                s = min(max((px * ex + py * ey) / length_sq, 0.0), 1.0)
                away_m[row, col] = min(away_m[row, col], math.hypot(px - s * ex, py - s * ey))


@numba.njit(cache=True, error_model="numpy")
def _search(free: Bools, start: tuple[int, int], goal: tuple[int, int], before: NDArray[np.int8]) -> bool:
    """Whether A* finds a way over free cells; `before` (H, W) has the step of `_STEPS` by which a cell was reached."""
    height, width = free.shape
    cost = np.full(free.shape, np.inf)
    cost[start] = 0.0
    heap = [(0.0, start[0], start[1])]
    while len(heap):
        estimate, row, col = heapq.heappop(heap)
        if (row, col) == goal:
            return True
        away = _octile(row, col, goal)
        if estimate > cost[row, col] + away + 1e-9:
            continue  # a shorter way was found since
        for k in range(8):
            r, c = row + _STEPS[k, 0], col + _STEPS[k, 1]
            if not (0 <= r < height and 0 <= c < width and free[r, c]):
                continue
            if k >= 4 and not (free[row, c] and free[r, col]):
                continue  # no way between two cells that meet at a corner
            through = cost[row, col] + (math.sqrt(2.0) if k >= 4 else 1.0)
            if through < cost[r, c] - 1e-9:
                cost[r, c] = through
                before[r, c] = k
                heapq.heappush(heap, (through + _octile(r, c, goal), r, c))
    return False


@numba.njit(cache=True, error_model="numpy")
def _octile(row: int, col: int, goal: tuple[int, int]) -> float:
    """The cost of the shortest way over an empty grid."""
    down, across = abs(row - goal[0]), abs(col - goal[1])
    return max(down, across) + (math.sqrt(2.0) - 1.0) * min(down, across)


class WalkingSpace:
    """The free cells of a region, as someone with a body walks in it."""

    def __init__(self, walls: Array, region: Region) -> None:
        """Of the region (x0, y0, x1, y1) among `walls` (N, 2, 2), all that stops a person; metres, world frame."""
        x0, y0, x1, y1 = region
        self._origin = np.array([x0, y0])
        shape = max(math.ceil((y1 - y0) / _CELL_M), 1), max(math.ceil((x1 - x0) / _CELL_M), 1)
        self._away_m = np.full(shape, np.inf)
        flat = np.ascontiguousarray(walls.reshape(-1, 4), dtype=np.float64)
        mark_distances(flat, x0, y0, _CELL_M, 0.5 * _DOOR_M + _CELL_M, self._away_m)
        self.free: Bools = self._away_m >= BODY_M
        """(H, W) cells in whose centre a body fits"""

    def is_free(self, points: Array) -> Bools:
        """(...,) whether points (..., 2) lie in free cells."""
        cells = np.floor((points - self._origin) / _CELL_M).astype(np.int64)
        cols, rows = cells[..., 0], cells[..., 1]
        height, width = self.free.shape
        inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        return np.asarray(inside & self.free[np.where(inside, rows, 0), np.where(inside, cols, 0)])

    def centres(self, cells: Cells) -> Array:
        """(N, 2) centres, metres, of cells (N, 2), row and col."""
        return np.asarray(self._origin + _CELL_M * (cells[..., ::-1] + 0.5))

    def around(self, point: Array) -> Bools:
        """(H, W) the free cells to which a way leads from the one nearest to a point (2,); none if there are none."""
        if not self.free.any():
            return self.free
        labels: Any = ndimage.label(self.free)[0]
        return np.asarray(labels == labels[self._nearest_free(point)])

    def rooms(self, among: Bools) -> list[Cells]:
        """The cells (N, 2) of each room among cells (H, W): what is left connected when all doors are closed.

        Without any place wider than a door, it is one room.
        """
        labels, count = ndimage.label(among & (self._away_m > 0.5 * _DOOR_M))
        if count == 0:
            return [np.argwhere(among)]
        cells = np.argwhere(labels > 0)
        order = np.argsort(labels[labels > 0], kind="stable")
        return np.split(cells[order], np.cumsum(np.bincount(labels[labels > 0])[1:])[:-1])

    def way(self, start: Array, goal: Array, avoid: Sequence[tuple[Array, float]] = ()) -> Array | None:
        """The shortest way (N, 2), metres, from a point (2,) to another, both included; None if there is none.

        It keeps off the discs (centre, radius) of `avoid`.
        """
        free = self.free.copy() if avoid else self.free
        x = self._origin[0] + _CELL_M * (np.arange(free.shape[1]) + 0.5)
        y = self._origin[1] + _CELL_M * (np.arange(free.shape[0]) + 0.5)
        for centre, radius_m in avoid:
            free &= (x - centre[0]) ** 2 + ((y - centre[1]) ** 2)[:, None] > radius_m * radius_m
        first, last = self._nearest_free(start), self._nearest_free(goal)
        before = np.full(free.shape, -1, dtype=np.int8)
        if not free[last] or not _search(free, first, last, before):
            return None
        cells = [last]
        while cells[-1] != first:
            row, col = cells[-1]
            down, across = _STEPS[before[row, col]].tolist()
            cells.append((row - down, col - across))
        points = self.centres(np.array(cells[::-1]))
        return self._straightened(np.vstack([start, points[1:-1], goal]), free)

    def _nearest_free(self, point: Array) -> tuple[int, int]:
        """The free cell whose centre is nearest to a point; its own, if that is free."""
        if self.is_free(point):
            col, row = np.floor((point - self._origin) / _CELL_M).astype(np.int64).tolist()
            return row, col
        cells = np.argwhere(self.free)
        row, col = cells[np.argmin(((self.centres(cells) - point) ** 2).sum(axis=1))].tolist()
        return row, col

    def _straightened(self, way: Array, free: Bools) -> Array:
        """The way without the points that it can do without: from each to the farthest that is seen over free cells."""
        kept = [0]
        while kept[-1] < len(way) - 1:
            k = kept[-1] + 1
            while k + 1 < len(way) and self._sees(way[kept[-1]], way[k + 1], free):
                k += 1
            kept.append(k)
        return np.asarray(way[kept])

    def _sees(self, a: Array, b: Array, free: Bools) -> bool:
        count = math.ceil(2.0 * math.dist(a, b) / _CELL_M) + 1
        points = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
        cols, rows = np.floor((points - self._origin) / _CELL_M).astype(np.int64).T
        return bool(free[rows.clip(0, free.shape[0] - 1), cols.clip(0, free.shape[1] - 1)].all())


class ScriptedWalk(Section):
    """A walk that a scene states: way points that someone visits again and again, each by the shortest way."""

    points: tuple[tuple[Coordinate, Coordinate], ...]
    speed: Annotated[float, Field(gt=0.0, le=3.0)] = 1.0
    """m/s"""
    pauses: tuple[Annotated[float, Field(ge=0.0, le=1e6)], ...] | None = None
    """at each way point, s; None: none"""

    @model_validator(mode="after")
    def _paused(self) -> Self:
        if self.pauses is not None and len(self.pauses) != len(self.points):
            allowed = f"a time for each of the {len(self.points)} way points"
            raise InputError("pauses", f"found {len(self.pauses)}", allowed)
        return self

    def pause_s(self, k: int) -> float:
        """The pause at way point k."""
        return 0.0 if self.pauses is None else self.pauses[k]


def read_walks(tables: Any) -> tuple[ScriptedWalk, ...]:
    """The tables `walkers` of a scene; InputError that names the field."""
    walks = read_each("walkers", tables, functools.partial(read_section, kind=ScriptedWalk))
    if len(walks) > _MOST_WALKS:
        raise InputError("walkers", f"found {len(walks)}", f"at most {_MOST_WALKS}")
    return tuple(walks)


def check_walks(walks: Sequence[ScriptedWalk], solid: Array, region: Region) -> None:
    """Raise InputError for a way point in a wall or outside the region, and for two between which no way leads."""
    if not walks:
        return
    space = WalkingSpace(solid, region)
    for k, walk in enumerate(walks, 1):
        points = np.array(walk.points)
        for number, (point, free) in enumerate(zip(points, space.is_free(points), strict=True), 1):
            if not free:
                found = f"({point[0]:g}, {point[1]:g}), in a wall or outside the region"
                allowed = f"a place with room for a body of {BODY_M:g} m"
                raise InputError(f"walkers, entry {k}, point {number}", f"found {found}", allowed)
        for number, (a, b) in enumerate(zip(points, np.roll(points, -1, axis=0), strict=True), 1):
            if space.way(a, b) is None:
                there = f"from ({a[0]:g}, {a[1]:g}) to ({b[0]:g}, {b[1]:g})"
                raise InputError(
                    f"walkers, entry {k}, point {number}", f"found no way {there}", "points that ways join"
                )
