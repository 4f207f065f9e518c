"""Submaps to match scans with, all places of points in one by branch and bound, and what places look like.

Hess, Kohler, Rapp and Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, search for the best place alone.
What is bounded here is the least score that is asked for, so that the places that look alike are found together. One
level of blocks is enough: their bounds are sums of contiguous bytes, and below the best of them most need no closer
look.

What a place looks like, whatever pose it is seen from, is how often two points of it are so far and so turned apart.
Pairs of surface points are counted by their distance, by the angle between their normals and by those of both normals
with the line from one to the other, as in point pair features (Drost, Ulrich, Navab and Ilic, "Model globally, match
locally", CVPR 2010) and shape distributions (Osada, Funkhouser, Chazelle and Dobkin, ACM TOG 21(4), 2002). A shift or a
turn leaves the counts as they are, and neighbouring poses see much the same pairs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.slam.scans.returns import Returns

CELL_M = 0.1
"""of a submap, of which one point is kept"""
MOST_POINTS = 200
"""of a place that are searched for, and whose pairs are counted"""
BLOCK = 4  # cells along the side of a block
PEAK = 2  # of a cell with a point; cells beside one have half of it, and sums fit into 16 bits
NEAR_M = 12.0
"""farther returns are few, and their place depends on the heading"""


class Pyramid(NamedTuple):
    """How well a point fits into a submap, by cell and by block of cells."""

    values: NDArray[np.uint8]
    """(columns, rows), `PEAK` for a cell with a point"""
    blocks: NDArray[np.uint8]
    """(BLOCK, BLOCK, n, m), at (a, b, i, j) the maximum over BLOCK x BLOCK cells from (BLOCK i + a, BLOCK j + b) on"""
    x0: float
    """m, submap's frame, of the first cell's corner"""
    y0: float


def surfaces(returns: Returns, keys: NDArray[np.int64], at: Array, range_m: float = NEAR_M) -> Array:
    """(N, 4) points and normals of keyframes in the frame of their poses `at` (n, 3), the first one in each cell.

    Returns beyond `range_m` are left out; a point without a normal has (0, 0).
    """
    points, normals = returns.points[keys].astype(np.float64), returns.normals[keys].astype(np.float64)
    (x, y, distance), (nx, ny, _) = (np.moveaxis(rows, -1, 0) for rows in (points, normals))
    c, s = np.cos(at[:, 2:]), np.sin(at[:, 2:])
    found = np.stack([at[:, :1] + c * x - s * y, at[:, 1:2] + s * x + c * y, c * nx - s * ny, s * nx + c * ny], axis=-1)
    found = found[(distance > 0.0) & (distance <= range_m)]
    # A complex number for each cell: one number is sorted faster than two.
    _, first = np.unique(np.floor(found[:, :2] / CELL_M) @ [1.0, 1j], return_index=True)
    return np.asarray(found[np.sort(first)])


def pyramid(points: Array) -> Pyramid:
    """The pyramid of points (N, 2); where there are none, no point fits."""
    if not len(points):
        return Pyramid(np.zeros((BLOCK, BLOCK), np.uint8), np.zeros((BLOCK, BLOCK, 1, 1), np.uint8), 0.0, 0.0)
    # Around the points there is room for a block: one that is not wholly inside the cells holds no point.
    low = points.min(axis=0) - CELL_M * (BLOCK + 1)
    cells = BLOCK * (((points.max(axis=0) + CELL_M - low) / CELL_M).astype(np.int64) // BLOCK + 2)
    values = np.zeros((cells[0], cells[1]), dtype=np.uint8)
    column, row = ((points - low) / CELL_M).astype(np.int64).T
    values[column, row] = 1
    values += maximum_filter(values, 3)
    pooled = maximum_filter(values, BLOCK, mode="constant", origin=-(BLOCK // 2))
    blocks = pooled.reshape(cells[0] // BLOCK, BLOCK, cells[1] // BLOCK, BLOCK).transpose(1, 3, 0, 2)
    return Pyramid(values, np.ascontiguousarray(blocks), float(low[0]), float(low[1]))


STEP_RAD = 0.012
"""between two headings that are tried"""
_MOST_SUMMED = np.iinfo(np.uint16).max // PEAK
"""points whose values can be summed in two bytes"""
MOST_TRIED = 8
"""candidates that are looked into closely"""


class Window(NamedTuple):
    """Poses to search."""

    centre: Array
    """(3,) x, y, theta in the submap's frame"""
    half_m: float
    """half the side of the square of positions"""
    half_rad: float
    """half the interval of headings"""


class Apart(NamedTuple):
    """How far two poses must be from each other to be of two places; one of both is enough."""

    distance_m: float
    turn_rad: float

    def same(self, off: Array) -> NDArray[np.bool_]:
        """(...,) whether relative poses (..., 3) are of one place."""
        near = np.hypot(off[..., 0], off[..., 1]) < self.distance_m
        return np.asarray(near & (np.abs(wrap_angle(off[..., 2])) < self.turn_rad))


PLACE = Apart(0.7, 0.2)
"""of two places: alignment leads to one pose from nearer ones"""


def peaks(pyramid: Pyramid, points: Array, window: Window, least: float, apart: Apart, most: int) -> Array:
    """(m, 4) score and pose in the submap's frame of the `most` best places of points (N, 2) in the window, best first.

    A score is the mean value of the points' cells, 0 to 1, and above `least`. A place is the best cell of a block. Of
    more points than can be summed every second one stands for all, or fewer.
    """
    points = points[:: max(1, math.ceil(len(points) / _MOST_SUMMED))]
    turns, cells = 2 * int(window.half_rad / STEP_RAD) + 1, int(window.half_m / CELL_M)
    turned = Turned(*_cells(pyramid, points, window, turns), cells)
    bounds = _bounds(pyramid.blocks, turned)
    lowest = math.floor(least * PEAK * len(points))
    blocks = np.flatnonzero(bounds > lowest)
    blocks = blocks[np.argsort(-bounds.ravel()[blocks].astype(np.int32), kind="stable")]
    found = _best_cells(pyramid.values, turned, bounds, blocks, lowest, most == 1)
    found = found[np.lexsort((found[:, 3], found[:, 2], found[:, 1], -found[:, 0]))]
    kept, steps = list[NDArray[np.int64]](), np.array([CELL_M, CELL_M, STEP_RAD])
    while len(found) and len(kept) < most:
        kept.append(found[0])
        found = found[~apart.same((found - found[0])[:, [2, 3, 1]] * steps)]
    best = np.array(kept, dtype=np.int64).reshape(-1, 4) - np.array([0, turns // 2, 0, 0])
    return np.column_stack([best[:, 0] / (PEAK * len(points)), window.centre + best[:, [2, 3, 1]] * steps])


class Turned(NamedTuple):
    """Cells of points at the window's centre, for each heading."""

    columns: NDArray[np.int32]
    """(turns, N)"""
    rows: NDArray[np.int32]
    """(turns, N)"""
    cells: int
    """half the side of the window"""


@numba.njit(cache=True, error_model="numpy")
def _bounds(blocks: NDArray[np.uint8], turned: Turned) -> NDArray[np.uint16]:
    """(turns, n, n) bounds of the sum of the points' values in each block of cells of the window."""
    wide, high, n = blocks.shape[2], blocks.shape[3], 2 * turned.cells // BLOCK + 1
    sums = np.zeros((len(turned.columns), n, n), np.uint16)
    for a in range(len(turned.columns)):
        for k in range(turned.columns.shape[1]):
            left, low = turned.columns[a, k] - turned.cells, turned.rows[a, k] - turned.cells
            layer, x, y = blocks[left % BLOCK, low % BLOCK], left // BLOCK, low // BLOCK
            first, last = max(0, -y), min(n, high - y)
            if first >= last:
                continue
            for i in range(max(0, -x), min(n, wide - x)):
                added, row = layer[x + i, y + first : y + last], sums[a, i, first:last]
                for j in range(len(row)):  # contiguous bytes: the compiler adds many at once
                    row[j] += added[j]
    return sums


@numba.njit(cache=True, error_model="numpy")
def _best_cells(
    values: NDArray[np.uint8],
    turned: Turned,
    bounds: NDArray[np.uint16],
    blocks: NDArray[np.int64],
    least: int,
    only_best: bool,
) -> NDArray[np.int64]:
    """(m, 4) sum, heading and cell of the best cell of each of `blocks`, indices of `bounds`, the largest bound first.

    With `only_best` blocks are left out whose bound is not above the best sum so far.
    """
    n, flat, best, m = bounds.shape[1], bounds.ravel(), least, 0
    found, sums = np.empty((len(blocks), 4), np.int64), np.empty((BLOCK, BLOCK), np.uint16)
    for block in blocks:
        if only_best and flat[block] <= best:
            break
        a, x, y = block // (n * n), block // n % n, block % n
        total, at_x, at_y = _best_cell(values, turned, a, x * BLOCK - turned.cells, y * BLOCK - turned.cells, sums)
        if total > least:
            found[m, 0], found[m, 1], found[m, 2], found[m, 3] = total, a, at_x, at_y
            best, m = max(best, total), m + 1
    return found[:m].copy()


@numba.njit(cache=True, error_model="numpy")
def _best_cell(
    values: NDArray[np.uint8], turned: Turned, a: int, left: int, low: int, sums: NDArray[np.uint16]
) -> tuple[int, int, int]:
    """The largest sum in the block that begins at (left, low), at heading a, and its cell; `sums` is overwritten."""
    width, height = values.shape[0] - BLOCK, values.shape[1] - BLOCK
    columns, rows = turned.columns[a], turned.rows[a]
    sums[:] = 0
    for k in range(len(columns)):
        i, j = columns[k] + left, rows[k] + low
        # Blocks over the edge hold no point: there is room around the points.
        if 0 <= i <= width and 0 <= j <= height:
            for p in range(BLOCK):
                for q in range(BLOCK):
                    sums[p, q] += values[i + p, j + q]
    best, x, y = -1, 0, 0
    for p in range(min(BLOCK, turned.cells + 1 - left)):
        for q in range(min(BLOCK, turned.cells + 1 - low)):
            if sums[p, q] > best:
                best, x, y = int(sums[p, q]), left + p, low + q
    return best, x, y


def _cells(pyramid: Pyramid, points: Array, window: Window, turns: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Columns and rows (turns, N) of the points at the window's centre, for each heading."""
    theta = window.centre[2] + (np.arange(turns) - turns // 2)[:, None] * STEP_RAD
    c, s, (px, py) = np.cos(theta), np.sin(theta), points.T
    x = window.centre[0] + c * px - s * py - pyramid.x0
    y = window.centre[1] + s * px + c * py - pyramid.y0
    # The floor, not the nearest cell: whole shifts must keep the bounds valid.
    return np.floor(x / CELL_M).astype(np.int32), np.floor(y / CELL_M).astype(np.int32)


_BIN_M, _BINS = 0.75, 24  # of distance; the last one has all that is farther
_ANGLES = 3  # bins of the cosine between normals, and of the sum of two cosines
BINS = _BINS * _ANGLES**2


def appearance(surfaces: Array) -> Array:
    """(BINS,) unit vector of points with normals (N, 4), x, y and the normal's; the product of two is 1 if alike.

    A point without a normal, (0, 0), is in no pair.
    """
    rows = np.linspace(0, len(surfaces) - 1, min(len(surfaces), MOST_POINTS)).astype(np.int64)
    kept = surfaces[rows]
    counts = _pairs(np.ascontiguousarray(kept[kept[:, 2:].any(axis=1)]))
    return np.asarray(np.sqrt(counts / max(counts.sum(), 1.0)))


@numba.njit(cache=True, error_model="numpy")
def _pairs(surfaces: Array) -> Array:
    """(BINS,) number of pairs of points with normals (N, 4) by distance and angles."""
    counts = np.zeros(BINS)
    for i in range(len(surfaces)):
        x, y, nx, ny = surfaces[i]
        for j in range(i):
            mx, my = surfaces[j, 2], surfaces[j, 3]
            dx, dy = surfaces[j, 0] - x, surfaces[j, 1] - y
            distance = max(math.sqrt(dx * dx + dy * dy), CELL_M)
            along = (abs(nx * dx + ny * dy) + abs(mx * dx + my * dy)) / distance
            apart = int(min(distance / _BIN_M, _BINS - 1))
            turned = int(min(_ANGLES * abs(nx * mx + ny * my), _ANGLES - 1))
            counts[_ANGLES * (_ANGLES * apart + turned) + int(min(_ANGLES * 0.5 * along, _ANGLES - 1))] += 1.0
    return counts
