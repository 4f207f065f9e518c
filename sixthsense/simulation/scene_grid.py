"""The clearance of a scene's cells: where a disc fits, which places it can reach, and the shortest way."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.core.geometry import Array

Bools = NDArray[np.bool_]
Cells = NDArray[np.int64]

_STEPS = np.array(sorted(itertools.product((-1, 0, 1), repeat=2), key=lambda step: abs(step[0]) + abs(step[1]))[1:])
"""to the eight cells beside one, row and col; straight ones first"""


@numba.njit(cache=True, error_model="numpy")
def _mark_distances(walls: Array, x0: float, y0: float, cell_m: float, reach_m: float, away_m: Array) -> None:
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
def _search(free: Bools, goal: tuple[int, int], start: tuple[int, int], step: NDArray[np.int8]) -> bool:
    """Whether Dijkstra's search from the goal reaches the start over free cells.

    `step` (H, W) is the step of `_STEPS`, backward, that leads from a cell to the goal.
    """
    height, width = free.shape
    cost = np.full(free.shape, np.inf)
    cost[goal] = 0.0
    heap = [(0.0, goal[0], goal[1])]
    while len(heap):
        reached, row, col = heapq.heappop(heap)
        if (row, col) == start:
            return True
        if reached > cost[row, col]:
            continue  # a shorter way was found since
        for k in range(8):
            r, c = row + _STEPS[k, 0], col + _STEPS[k, 1]
            if not (0 <= r < height and 0 <= c < width and free[r, c]):
                continue
            if k >= 4 and not (free[row, c] and free[r, col]):
                continue  # no way between two cells that meet at a corner
            through = reached + (math.sqrt(2.0) if k >= 4 else 1.0)
            if through < cost[r, c] - 1e-9:
                cost[r, c] = through
                step[r, c] = k
                heapq.heappush(heap, (through, r, c))
    return False


class SceneGrid:
    """The distance of cells from the nearest solid, world frame, and what a disc can do among them."""

    def __init__(self, solid: Array, low: Array, high: Array, cell_m: float, reach_m: float) -> None:
        """Cells of `cell_m` from `low` (2,) to `high` (2,) or beyond, among segments (N, 2, 2); metres.

        Distances are exact up to `reach_m`.
        """
        self.cell_m, self.low = cell_m, np.asarray(low, dtype=np.float64)
        width, height = np.maximum(np.ceil((high - self.low) / cell_m).astype(np.int64), 1)
        self.clearance_m: Array = np.full((height, width), np.inf)
        """(H, W) of the centres of cells, indexed [row = y, col = x]; at least the reach where it is larger"""
        self.add(solid, reach_m)

    def add(self, solid: Array, reach_m: float) -> None:
        """Add segments (N, 2, 2)."""
        flat = np.ascontiguousarray(solid.reshape(-1, 4), dtype=np.float64)
        _mark_distances(flat, self.low[0], self.low[1], self.cell_m, reach_m, self.clearance_m)

    def centres(self, cells: Cells) -> Array:
        """(..., 2) centres, metres, of cells (..., 2), row and col."""
        return np.asarray(self.low + self.cell_m * (cells[..., ::-1] + 0.5))

    def at(self, mask: NDArray[Any], points: Array) -> NDArray[Any]:
        """(...,) the values of `mask` (H, W) in the cells of points (..., 2); 0 outside."""
        cells = np.floor((points - self.low) / self.cell_m).astype(np.int64)
        cols, rows = cells[..., 0], cells[..., 1]
        inside = (rows >= 0) & (rows < mask.shape[0]) & (cols >= 0) & (cols < mask.shape[1])
        return np.asarray(np.where(inside, mask[np.where(inside, rows, 0), np.where(inside, cols, 0)], 0))

    def nearest(self, free: Bools, point: Array) -> tuple[int, int] | None:
        """Row and col of the free cell (H, W) whose centre is nearest to a point (2,); None without any."""
        if self.at(free, point):
            col, row = np.floor((point - self.low) / self.cell_m).astype(np.int64).tolist()
            return row, col
        cells = np.argwhere(free)
        if not len(cells):
            return None
        row, col = cells[np.argmin(((self.centres(cells) - point) ** 2).sum(axis=1))].tolist()
        return row, col

    def reachable(self, free: Bools, point: Array, within_m: float = math.inf) -> Bools:
        """(H, W) the free cells to which a way leads from the one nearest to a point (2,), if it is so near."""
        cell = self.nearest(free, point)
        if cell is None or math.dist(self.centres(np.array(cell)), point) > within_m:
            return np.zeros_like(free)
        labels: NDArray[Any] = ndimage.label(free)[0]
        return np.asarray(labels == labels[cell])

    def way(self, free: Bools, start: Array, goal: Array, avoid: Sequence[tuple[Array, float]] = ()) -> Array | None:
        """The shortest way (N, 2), metres, over free cells between points (2,), both included; None if there is none.

        It keeps off the discs (centre, radius) of `avoid`. It begins and ends at the nearest free cells.
        """
        first, last = self.nearest(free, start), self.nearest(free, goal)
        if first is None or last is None:
            return None
        if avoid:
            free = free.copy()
            x, y = (self.low[k] + self.cell_m * (np.arange(free.shape[1 - k]) + 0.5) for k in (0, 1))
            for centre, radius_m in avoid:
                free &= (x - centre[0]) ** 2 + ((y - centre[1]) ** 2)[:, None] > radius_m * radius_m
            free[first] = True
        step = np.full(free.shape, -1, dtype=np.int8)
        if not free[last] or not _search(free, last, first, step):
            return None
        cells = [first]
        while cells[-1] != last:
            row, col = cells[-1]
            down, across = _STEPS[step[row, col]].tolist()
            cells.append((row - down, col - across))
        points = self.centres(np.array(cells))
        return self._straightened(np.vstack([start, points[1:-1], goal]), free)

    def _straightened(self, way: Array, free: Bools) -> Array:
        """The way without points that are not needed: from each to the farthest that is seen over free cells."""
        kept = [0]
        while kept[-1] < len(way) - 1:
            k = kept[-1] + 1
            while k + 1 < len(way) and self._sees(way[kept[-1]], way[k + 1], free):
                k += 1
            kept.append(k)
        return np.asarray(way[kept])

    def _sees(self, a: Array, b: Array, free: Bools) -> bool:
        count = math.ceil(2.0 * math.dist(a, b) / self.cell_m) + 1
        return bool(self.at(free, a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)).all())
