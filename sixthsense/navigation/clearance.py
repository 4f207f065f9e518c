"""Clearance: how far each cell is from the nearest obstacle, and what a way through it costs.

Distances are measured from the centre of a cell to the means of the returns in obstacle cells, not to the squares of
these cells. In a gap that is about as wide as the robot, a cell is measured at the place in it that is in the middle of
the gap: so a gap is as wide as its returns are apart, whichever way it lies to the cells.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.geometry import Array
from sixthsense.navigation.guard import BUFFER_M
from sixthsense.slam.mapping.changes import Box, Revision, moved
from sixthsense.slam.mapping.freespace import Bools, Floats, FreeSpace
from sixthsense.slam.mapping.grid import Grid

OPPOSITE = 0.5
"""cosine: the other side of a gap lies at a smaller angle to the way across, that of a corner does not"""
_SIDE = 2  # cells from the middle of a gap to where the distance has to be less
_NOWHERE = Box(0, 0, 0, 0)


class Clearance:
    """The clearance of all cells of a grid, drawn again where the grid has changed.

    Cells are those of the grid's box, arrays are (H, W), indexed [row = y, col = x]. They are valid until the next
    update.
    """

    def __init__(self, cell_m: float, least_m: float, most_m: float) -> None:
        """Begin without a map. Gaps about as wide as twice `least_m` are measured; distances end at `most_m`."""
        self.cell_m, self.least_m, self.most_m = cell_m, least_m, max(most_m, least_m + 2.0 * cell_m)
        self.box = _NOWHERE
        """the box of the cells, counted from the world's origin"""
        self.metres: Floats = np.zeros((0, 0), dtype=np.float32)
        """(H, W) distance to the nearest obstacle, at most `most_m`"""
        self.offsets: Floats = np.zeros((0, 0, 2), dtype=np.float32)
        """(H, W, 2) row and col, in cells, from the centre of a cell to where it is measured; 0 outside narrow gaps"""
        self.seen: Bools = np.zeros((0, 0), dtype=np.bool_)
        """(H, W) cells of the grid that were seen"""
        self.obstacles = self.seen
        """(H, W) obstacle cells of the grid"""
        self._revision: Revision | None = None

    @property
    def first(self) -> NDArray[np.int64]:
        """(2,) row and col of the corner of the cells, counted from the world's origin."""
        return np.array([self.box.top, self.box.left])

    @property
    def origin(self) -> tuple[float, float]:
        """World x, y of the lower left corner of the cells, metres."""
        return self.box.left * self.cell_m, self.box.top * self.cell_m

    def update(self, grid: Grid) -> None:
        """Draw the clearance again where the grid has changed."""
        box, reach = grid.box, math.ceil(self.most_m / self.cell_m) + 1
        changed = grid.changes.since(self._revision)
        self._revision = grid.changes.revision
        if changed == _NOWHERE:
            return
        if box != self.box:
            before, self.box = self.box, box
            for name, fill in (("metres", self.most_m), ("offsets", 0.0), ("seen", False), ("obstacles", False)):
                setattr(self, name, moved(getattr(self, name), before, box, fill))
        part = (box if changed is None else changed.grown(reach)).within((box.top, box.left), self.metres.shape)
        drawn = Box(box.top + part[0].start, box.left + part[1].start, box.top + part[0].stop, box.left + part[1].stop)
        if drawn.bottom == drawn.top or drawn.right == drawn.left:
            return
        points = grid.obstacle_points(drawn.grown(reach))[:, ::-1] / self.cell_m - (drawn.top, drawn.left)
        limits = (self.least_m - BUFFER_M) / self.cell_m, self.least_m / self.cell_m, self.most_m / self.cell_m
        cells, self.offsets[part] = _draw(drawn.bottom - drawn.top, drawn.right - drawn.left, points, limits)
        self.metres[part] = cells * np.float32(self.cell_m)
        self.seen[part], self.obstacles[part] = grid.part("seen", drawn), grid.part("obstacles", drawn)

    def cell(self, point_world: ArrayLike) -> tuple[int, int]:
        """Row and col of a (2,) point, clipped to the cells."""
        x, y = np.asarray(point_world, dtype=np.float64).tolist()
        row, col = math.floor(y / self.cell_m) - self.box.top, math.floor(x / self.cell_m) - self.box.left
        return min(max(row, 0), self.metres.shape[0] - 1), min(max(col, 0), self.metres.shape[1] - 1)

    def free_space(
        self, least_m: float, wish_m: float, robot: ArrayLike | None = None, unseen_m: float = math.inf
    ) -> FreeSpace:
        """Where the robot may drive, and what a metre there costs.

        Cells nearer than `least_m` to an obstacle are blocked. A metre costs 1, and (wish / clearance)^2 where its
        clearance is less than `wish_m`, like in Nav2's inflation layer. A `robot` (2,) that stands where it is blocked
        may go where the clearance is no less than it has, within `wish_m`. Cells that are farther than `unseen_m` from
        all seen ones are blocked.
        """
        cost = np.maximum(self.metres, np.float32(0.5 * self.cell_m))
        np.divide(np.float32(wish_m), cost, out=cost)
        np.square(np.maximum(cost, np.float32(1.0), out=cost), out=cost)
        blocked: Bools = self.metres < least_m
        if robot is not None and blocked[self.cell(robot)]:
            blocked = blocked & ~self._way_out(self.cell(robot), wish_m)
        if unseen_m < math.inf:
            reach, (height, width) = max(1, round(unseen_m / self.cell_m)), blocked.shape
            seen, shifts = np.pad(self.seen, reach), range(2 * reach + 1)  # much faster than by `scipy.ndimage`
            near = functools.reduce(np.bitwise_or, [seen[k : k + height] for k in shifts])
            blocked = blocked | ~functools.reduce(np.bitwise_or, [near[:, k : k + width] for k in shifts])
        np.copyto(cost, np.inf, where=blocked)
        cost.flags.writeable = False  # so that it is not copied
        return FreeSpace(blocked, self.seen, self.origin, self.cell_m, cost, self.offsets)

    def _way_out(self, cell: tuple[int, int], reach_m: float) -> Bools:
        """(H, W) the cells near one that have no less clearance than it, and itself."""
        out = np.zeros_like(self.obstacles)
        reach = math.ceil(reach_m / self.cell_m)
        part = tuple(slice(max(k - reach, 0), k + reach + 1) for k in cell)
        out[part] = (self.metres[part] >= self.metres[cell]) & ~self.obstacles[part]
        out[cell] = True
        return out


@numba.njit(cache=True, error_model="numpy")
def _draw(height: int, width: int, points: Array, limits: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """(H, W) distances of cells to points (N, 2), row and col from the corner, and (H, W, 2) where they are measured.

    All in cells. `limits` are the distances between which cells may be blocked, and the largest one.
    """
    lowest, least, most = limits
    wide = np.full((height + 2 * _SIDE, width + 2 * _SIDE), np.float32(most * most))  # with a rim
    across_sq = np.empty(2 * math.ceil(most) + 2, dtype=np.float32)
    for k in range(len(points)):
        row, col = points[k, 0] - 0.5 + _SIDE, points[k, 1] - 0.5 + _SIDE
        first = max(math.ceil(col - most), 0)
        last = max(min(math.floor(col + most) + 1, wide.shape[1]), first)
        for c in range(first, last):
            across_sq[c - first] = np.float32((c - col) ** 2)
        for r in range(max(math.ceil(row - most), 0), min(math.floor(row + most) + 1, len(wide))):
            # A slice, and nothing else in the loop: several cells at once.
            down_sq, line = np.float32((r - row) ** 2), wide[r, first:last]
            for c in range(len(line)):
                line[c] = min(line[c], down_sq + across_sq[c])
    wide = np.sqrt(wide)
    distance, offsets = wide[_SIDE:-_SIDE, _SIDE:-_SIDE].copy(), np.zeros((height, width, 2), np.float32)
    reach = math.ceil(least) + 2
    at = np.full((height + 2 * reach, width + 2 * reach), -1, dtype=np.int32)  # the point in each cell
    for k in range(len(points)):
        r, c = math.floor(points[k, 0]) + reach, math.floor(points[k, 1]) + reach
        if 0 <= r < at.shape[0] and 0 <= c < at.shape[1]:
            at[r, c] = k
    near = np.empty((len(points), 2))
    for r in range(height):
        for c in range(width):
            if lowest - 1.0 <= distance[r, c] < least + 0.5 and _is_ridge(wide, r + _SIDE, c + _SIDE):
                count = 0
                for i in range(r, r + 2 * reach + 1):
                    for j in range(c, c + 2 * reach + 1):
                        if at[i, j] >= 0:
                            near[count] = points[at[i, j]]
                            count += 1
                down, across, away = _middle(near[:count], r + 0.5, c + 0.5)
                if away > distance[r, c]:
                    offsets[r, c, 0], offsets[r, c, 1] = np.float32(down), np.float32(across)
                    distance[r, c] = np.float32(away)
    return distance, offsets


@numba.njit(cache=True, error_model="numpy")
def _is_ridge(distance: Floats, row: int, col: int) -> bool:
    """Whether the distances (H, W) fall on two opposite sides of a cell: there may be a gap."""
    for down, across in ((0, _SIDE), (_SIDE, 0), (_SIDE, _SIDE), (_SIDE, -_SIDE)):
        least = float(distance[row, col]) - 0.5
        if distance[row + down, col + across] < least and distance[row - down, col - across] < least:
            return True
    return False


@numba.njit(cache=True, error_model="numpy")
def _middle(points: Array, row: float, col: float) -> tuple[float, float, float]:
    """The offset from a cell's centre to the middle of the gap that it is in, within the cell, and its distance.

    `points` (N, 2) are those around it. Without a gap the distance is 0.
    """
    near, down, across = np.inf, 0.0, 0.0
    for point in points:
        away = math.hypot(row - point[0], col - point[1])
        if 0.0 < away < near:
            near, down, across = away, (row - point[0]) / away, (col - point[1]) / away
    far = np.inf
    for point in points:
        to_row, to_col = point[0] - row, point[1] - col
        away = math.hypot(to_row, to_col)
        if to_row * down + to_col * across > OPPOSITE * away:
            far = min(far, away)
    if far == np.inf:
        return 0.0, 0.0, 0.0
    shift = min(0.5 * (far - near), 0.49 / max(abs(down), abs(across)))
    down, across, found = down * shift, across * shift, np.inf
    for point in points:
        found = min(found, math.hypot(row + down - point[0], col + across - point[1]))
    return down, across, found
