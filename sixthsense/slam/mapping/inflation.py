"""Inflation of obstacles by a disc, and where a wider one gives way to a narrower."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import TOUCH, Bools, FreeSpace

MAX_INFLATION = 1000
"""Cells; a larger disc takes longer to draw than a robot takes to drive."""


def check_inflation(cells: float) -> None:
    """Raise InputError for an inflation of more than `MAX_INFLATION` cells."""
    if cells > MAX_INFLATION:
        raise InputError("grid", f"found an inflation of {cells:.0f} cells", f"at most {MAX_INFLATION}")


def disc(radius: float) -> NDArray[np.int64]:
    """(K, 2) offsets (row, col) of the cells about whose centres a disc, in cells, touches the square at (0, 0)."""
    reach = math.floor(radius + 0.5 + TOUCH)
    offsets = np.arange(-reach, reach + 1)
    gap = np.maximum(np.abs(offsets) - 0.5, 0.0)
    return np.argwhere(np.hypot(gap[:, None], gap[None, :]) <= radius + TOUCH) - reach


def disc_cells(centres: Array, radius_m: float, cell_m: float) -> NDArray[np.int64]:
    """(K, 2) cells, row, col from the world's origin, of discs about centres (N, 2), metres; none of them twice."""
    at = np.floor(centres / cell_m).astype(np.int64)[:, ::-1]
    return np.unique((at[:, None] + disc(radius_m / cell_m)[None]).reshape(-1, 2), axis=0)


def marked(box: Box, cells: NDArray[np.int64]) -> Bools:
    """(H, W) which cells of a box are among cells (K, 2), row, col from the world's origin."""
    mask = np.zeros((box.bottom - box.top, box.right - box.left), dtype=np.bool_)
    rows, cols = (cells - np.array([box.top, box.left])).T
    inside = (rows >= 0) & (rows < mask.shape[0]) & (cols >= 0) & (cols < mask.shape[1])
    mask[rows[inside], cols[inside]] = True
    return mask


@numba.njit(cache=True, error_model="numpy")
def stamp_discs(cells: NDArray[np.int64], stencil: NDArray[np.int64], blocked2: Bools) -> None:
    """Block the `stencil` (K,) of flat offsets about each of the flat `cells` (N,); it must not leave the array."""
    blocked = blocked2.ravel()
    for cell in cells:
        for offset in stencil:
            blocked[cell + offset] = True


def stamped(obstacles: Bools, stencil: NDArray[np.int64]) -> Bools:
    """(H, W) the cells that the `stencil` (K, 2) of offsets about an obstacle covers."""
    rim = int(np.abs(stencil).max(initial=0))
    blocked = np.zeros((obstacles.shape[0] + 2 * rim, obstacles.shape[1] + 2 * rim), dtype=np.bool_)
    rows, cols = np.nonzero(obstacles)
    width = blocked.shape[1]
    stamp_discs((rows + rim) * width + cols + rim, stencil[:, 0] * width + stencil[:, 1], blocked)
    return blocked[rim : rim + obstacles.shape[0], rim : rim + obstacles.shape[1]].copy()


@numba.njit(cache=True, error_model="numpy")
def near_points(shape: tuple[int, int], points: Array, distance: float) -> Bools:
    """(H, W) the cells in which no place is farther than a distance from points (N, 2), row and col from the corner.

    Places are the middles of the parts that a cell's sides are divided into: three, less than the noise of a range.
    """
    height, width = shape
    begun = np.zeros((3 * height, 3 * width + 1), dtype=np.int32)  # discs, less those that end
    fine = 3.0 * distance
    for k in range(len(points)):
        row, col = 3.0 * points[k, 0] - 0.5, 3.0 * points[k, 1] - 0.5
        for r in range(max(math.ceil(row - fine), 0), min(math.floor(row + fine) + 1, 3 * height)):
            half = math.sqrt(max(fine * fine - (r - row) ** 2, 0.0))
            first, past = max(math.ceil(col - half), 0), min(math.floor(col + half) + 1, 3 * width)
            if first < past:
                begun[r, first] += 1
                begun[r, past] -= 1
    near = np.ones((height, width), dtype=np.bool_)
    for r in range(3 * height):
        covering = 0
        for c in range(width):
            first = covering + begun[r, 3 * c]
            second = first + begun[r, 3 * c + 1]
            covering = second + begun[r, 3 * c + 2]
            near[r // 3, c] &= (first > 0) & (second > 0) & (covering > 0)
    return near


def too_near(obstacles: Bools, radius: float) -> Bools:
    """(H, W) the cells whose centre is nearer to an obstacle cell's centre than a radius, in cells."""
    reach = math.floor(radius) + 1
    offsets = np.arange(-reach, reach + 1)
    return stamped(obstacles, np.argwhere(np.hypot(offsets[:, None], offsets[None, :]) < radius) - reach)


def give_way(blocked: Bools, origin: tuple[float, float], narrow: FreeSpace, point: ArrayLike, radius_m: float) -> None:
    """Near a point, block only those cells of `blocked` that `narrow` blocks too.

    The lower left corner of `blocked` is `origin`; its cells with centres within `radius_m` of the point change, the
    point's own cell included. `narrow` has cells at the same places, `blocked` may have more of them.
    """
    cell_m, at = narrow.cell_m, np.asarray(point, dtype=np.float64)
    row, col = math.floor((at[1] - origin[1]) / cell_m), math.floor((at[0] - origin[0]) / cell_m)
    reach = math.ceil(radius_m / cell_m) + 1
    height, width = blocked.shape
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, height))
    cols = np.arange(max(col - reach, 0), min(col + reach + 1, width))
    x, y = origin[0] + (cols + 0.5) * cell_m, origin[1] + (rows + 0.5) * cell_m
    near = np.hypot(x[None, :] - at[0], y[:, None] - at[1]) <= radius_m + cell_m
    down, across = (round((origin[k] - narrow.origin[k]) / cell_m) for k in (1, 0))
    blocked_in_narrow = narrow.window(rows + down, cols + across)
    blocked[np.ix_(rows, cols)] &= blocked_in_narrow | ~near


def giving_way(wide: FreeSpace, narrow: FreeSpace, places: Array, radius_m: float) -> FreeSpace:
    """The free space `wide` that gives way to `narrow` around (K, 2) places, as of `give_way`."""
    blocked = wide.blocked.copy()
    for point in places:
        give_way(blocked, wide.origin, narrow, point, radius_m)
    blocked.flags.writeable = False
    return FreeSpace(blocked, wide.seen, wide.origin, wide.cell_m)
