"""The clearance of a scene's cells: where a disc fits, which places it can reach, and the shortest way."""

from __future__ import annotations

import heapq
import itertools
import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.core.geometry import Array

Bools = NDArray[np.bool_]
Cells = NDArray[np.int64]

_MOST_CELLS = 10_000_000
_STEPS = np.array(sorted(itertools.product((-1, 0, 1), repeat=2), key=lambda step: abs(step[0]) + abs(step[1]))[1:])
"""to the eight cells beside one, row and col; straight ones first"""


@numba.njit(cache=True, error_model="numpy")
def wall_distance(x: float, y: float, walls: Array, j: int) -> float:
    """Distance of a point from segment `j` of `walls` (M, 4)."""
    ax, ay, ex, ey = walls[j, 0], walls[j, 1], walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
    s = min(max(((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
    return math.hypot(ax + s * ex - x, ay + s * ey - y)


@numba.njit(cache=True, error_model="numpy")
def _mark_distances(walls: Array, x0: float, y0: float, cell_m: float, reach_m: float, away_m: Array) -> None:
    """Lower `away_m` (H, W) to the distance of each cell's centre from the nearest of `walls` (M, 4) within reach."""
    height, width = away_m.shape
    for j in range(walls.shape[0]):
        left, right = min(walls[j, 0], walls[j, 2]) - reach_m, max(walls[j, 0], walls[j, 2]) + reach_m
        low, high = min(walls[j, 1], walls[j, 3]) - reach_m, max(walls[j, 1], walls[j, 3]) + reach_m
        for row in range(max(int((low - y0) / cell_m), 0), min(int((high - y0) / cell_m) + 1, height)):
            for col in range(max(int((left - x0) / cell_m), 0), min(int((right - x0) / cell_m) + 1, width)):
                away = wall_distance(x0 + (col + 0.5) * cell_m, y0 + (row + 0.5) * cell_m, walls, j)
                away_m[row, col] = min(away_m[row, col], away)


@numba.njit(cache=True, error_model="numpy")
def _shortest(free: Bools, start: tuple[int, int], goal: tuple[int, int]) -> Cells:
    """(N, 2) the cells of a shortest way over free cells, both ends included, by Dijkstra's search; none if none is."""
    height, width = free.shape
    cost, step = np.full(free.shape, np.inf), np.zeros(free.shape, np.int8)
    cost[goal] = 0.0
    heap = [(0.0, goal[0], goal[1])]
    while len(heap):
        reached, row, col = heapq.heappop(heap)
        if (row, col) == start:
            break
        if reached > cost[row, col]:
            continue  # a shorter way was found since
        for k in range(8):
            r, c = row + _STEPS[k, 0], col + _STEPS[k, 1]
            if not (0 <= r < height and 0 <= c < width and free[r, c]):
                continue
            if k >= 4 and not (free[row, c] and free[r, col]):
                continue  # no way between two cells that meet at a corner
            through = reached + (math.sqrt(2.0) if k >= 4 else 1.0)
            if through < cost[r, c]:
                cost[r, c], step[r, c] = through, k
                heapq.heappush(heap, (through, r, c))
    way, count, (row, col) = np.empty((free.size, 2), np.int64), 0, start
    while cost[start] < np.inf:
        way[count, 0], way[count, 1] = row, col
        count += 1
        if (row, col) == goal:
            break
        k = step[row, col]
        row, col = row - _STEPS[k, 0], col - _STEPS[k, 1]
    return way[:count].copy()


class SceneGrid:
    """The distance of cells from the nearest solid, world frame, and what a disc can do among them."""

    def __init__(self, solid: Array, low: Array, high: Array, cell_m: float, reach_m: float) -> None:
        """Cells of `cell_m` from `low` (2,) to `high` (2,) or beyond, among segments (N, 2, 2); metres.

        In a very large area cells are larger. Distances are exact up to `reach_m`.
        """
        self.cell_m, self.low = max(cell_m, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS)), np.asarray(low)
        width, height = np.maximum(np.ceil((high - low) / self.cell_m).astype(np.int64), 1)
        self.clearance_m: Array = np.full((height, width), np.inf)
        """(H, W) of the centres of cells, indexed [row = y, col = x]; at least the reach where it is larger"""
        self.add(solid, reach_m)

    def add(self, solid: Array, reach_m: float) -> None:
        """Add segments (N, 2, 2)."""
        flat = np.ascontiguousarray(solid.reshape(-1, 4), dtype=np.float64)
        _mark_distances(flat, float(self.low[0]), float(self.low[1]), self.cell_m, reach_m, self.clearance_m)

    def centres(self, cells: Cells) -> Array:
        """(..., 2) centres, metres, of cells (..., 2), row and col."""
        return np.asarray(self.low + self.cell_m * (cells[..., ::-1] + 0.5))

    def at(self, mask: NDArray[Any], points: Array) -> NDArray[Any]:
        """(...,) the values of `mask` (H, W) in the cells of points (..., 2); 0 outside."""
        cols, rows = np.moveaxis(np.floor((points - self.low) / self.cell_m).astype(np.int64), -1, 0)
        inside = (rows >= 0) & (rows < mask.shape[0]) & (cols >= 0) & (cols < mask.shape[1])
        return np.where(inside, mask[np.where(inside, rows, 0), np.where(inside, cols, 0)], mask.dtype.type(0))

    def nearest(self, free: Bools, point: Array) -> tuple[int, int]:
        """Row and col of the free cell (H, W) whose centre is nearest to a point (2,); there must be one."""
        cells = np.argwhere(free)
        row, col = cells[np.argmin(((self.centres(cells) - point) ** 2).sum(axis=1))].tolist()
        return row, col

    def reachable(self, free: Bools, point: Array, within_m: float = math.inf) -> Bools:
        """(H, W) the free cells to which a way leads from the one nearest to a point (2,), if it is so near."""
        if not free.any() or math.dist(self.centres(np.array(cell := self.nearest(free, point))), point) > within_m:
            return np.zeros_like(free)
        labels: NDArray[Any] = ndimage.label(free)[0]
        return np.asarray(labels == labels[cell])

    def way(self, free: Bools, start: Array, goal: Array) -> Array:
        """The shortest way (N, 2), metres, over free cells between points (2,), both included; empty if there is none.

        It begins and ends at the nearest free cells. Each of its points is the farthest that is seen from the last one.
        """
        cells = _shortest(free, self.nearest(free, start), self.nearest(free, goal))
        if not len(cells):
            return np.zeros((0, 2))
        way, kept = np.vstack([start, self.centres(cells[1:-1]), goal]), [0]
        while kept[-1] < len(way) - 1:
            k = kept[-1] + 1
            while k + 1 < len(way) and self._sees(way[kept[-1]], way[k + 1], free):
                k += 1
            kept.append(k)
        return np.asarray(way[kept])

    def _sees(self, a: Array, b: Array, free: Bools) -> bool:
        count = math.ceil(2.0 * math.dist(a, b) / self.cell_m) + 1
        return bool(self.at(free, np.linspace(a, b, count)).all())
