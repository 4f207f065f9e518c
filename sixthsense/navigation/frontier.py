"""Frontiers: free cells that were seen, beside cells that were not (Yamauchi, CIRA 1997).

Masks are (H, W), indexed [row = y, col = x]. Lengths are in cells.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.regions import Cells, Nodes, frontier_cells, joined, small_regions
from sixthsense.slam.mapping.freespace import Bools


def frontier_points(
    seen: Bools, obstacles: Bools, origin: tuple[float, float], cell_m: float, region: tuple[float, ...] | None
) -> Array:
    """(N, 2) centres of all frontier cells, world frame, metres.

    `seen` and `obstacles` (H, W) have their lower left corner at `origin`. Unseen cells outside `region`
    (x0, y0, x1, y1) make no frontier. Gaps of one or two cells in obstacles are closed.
    """
    closed = close_gaps(obstacles)
    unseen = ~(seen | closed)
    if region is not None:
        x0, y0, x1, y1 = region
        y = origin[1] + (np.arange(seen.shape[0]) + 0.5) * cell_m
        x = origin[0] + (np.arange(seen.shape[1]) + 0.5) * cell_m
        unseen &= ((y > y0) & (y < y1))[:, None] & ((x > x0) & (x < x1))[None, :]
    edge = np.argwhere(frontier_cells(seen & ~closed, unseen))
    return np.asarray((edge[:, ::-1] + 0.5) * cell_m + np.array(origin))


def close_gaps(obstacles: Bools) -> Bools:
    """`obstacles` after a morphological closing by 3 x 3 cells: a gap of one or two cells in a wall is noise."""
    return _eroded(dilated(np.pad(obstacles, 2)))[2:-2, 2:-2]


@numba.njit(cache=True, error_model="numpy")
def close_unseen_gaps(obstacles: Bools, seen: Bools, most: int) -> Bools:
    """`obstacles` and the cells of gaps in walls that are up to `most` cells wide and into which no beam has fallen.

    Unseen cells alone lead from one obstacle to another, along a row, a column or a diagonal; of a wall at an angle to
    that, both may be beside. Beams that meet a wall far off, or at a grazing angle, leave such gaps, and a robot that
    is as wide finds no way there.
    """
    height, width = obstacles.shape
    closed = obstacles.copy()
    for row in range(height):
        for col in range(width):
            if not obstacles[row, col]:
                continue
            for d_row, d_col in ((0, 1), (1, 0), (1, 1), (1, -1)):
                for beside in (-1, 0, 1):
                    r, c = row + d_row + beside * d_col, col + d_col - beside * d_row
                    gap, is_gap = 0, False
                    while gap <= most and 0 <= r < height and 0 <= c < width:
                        is_gap = obstacles[r, c] or _has_beside(obstacles, r, c, d_row, d_col)
                        if is_gap or seen[r, c]:
                            break
                        r, c, gap = r + d_row, c + d_col, gap + 1
                    if is_gap and gap <= most:
                        for k in range(gap):
                            closed[r - (k + 1) * d_row, c - (k + 1) * d_col] = True
    return closed


@numba.njit(cache=True, error_model="numpy")
def _has_beside(mask: Bools, row: int, col: int, d_row: int, d_col: int) -> bool:
    """Whether a cell beside one, across a direction, is of `mask`."""
    height, width = mask.shape
    for side in (1, -1):
        r, c = row + side * d_col, col - side * d_row
        if 0 <= r < height and 0 <= c < width and mask[r, c]:
            return True
    return False


def dilated(mask: Bools) -> Bools:
    """`mask` and the eight neighbours of its cells."""
    wide = mask.copy()
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    high = wide.copy()
    high[1:] |= wide[:-1]
    high[:-1] |= wide[1:]
    return high


def _eroded(mask: Bools) -> Bools:
    return ~dilated(~mask)


def smallest_regions(unseen: Bools, edge: Cells, max_cells: float) -> Nodes:
    """(N,) flat cells of the smallest regions of `unseen`, up to `max_cells` in all.

    Regions are connected edge to edge. One without a cell of `edge` (N, 2) beside it is not visible and does not count.
    """
    cells, ends = small_regions(unseen, edge, math.floor(max_cells))
    if len(ends) == 0:
        return cells
    sizes = np.diff(ends, prepend=0)
    order = np.lexsort((np.minimum.reduceat(cells, ends - sizes), sizes))  # of equals the first, row by row
    is_small = np.zeros(len(sizes), dtype=np.bool_)
    is_small[order[np.cumsum(sizes[order]) <= max_cells]] = True
    return np.asarray(cells[np.repeat(is_small, sizes)])


def frontier_clusters(edge: Cells, tile: int, first: Cells) -> list[Cells]:
    """The cells (N, 2) of each connected part of a frontier within each square of `tile` cells.

    `edge` (M, 2), row by row, are the cells of the frontier, in a map whose cell (0, 0) is `first` (2,) of the world.
    """
    if len(edge) == 0:
        return []
    rows, cols = ((edge + first) // tile).T
    square = (cols - cols.min()) * (np.ptp(rows) + 1) + rows - rows.min()
    keys = square * len(edge) + joined(edge)
    order = np.argsort(keys, kind="stable")
    keys, cells = keys[order], edge[order]
    starts = np.flatnonzero(np.diff(keys)) + 1
    return [cells[a:b] for a, b in zip([0, *starts], [*starts, len(cells)], strict=True)]


def adjacent_cells(mask: Bools, cells: Cells) -> Cells:
    """(M, 2) the cells of `mask` that share an edge with one of (N, 2) `cells`, each once."""
    return np.stack(np.divmod(np.unique(_adjacent(mask, cells)), max(mask.shape[1], 1)), axis=1)


@numba.njit(cache=True, error_model="numpy")
def _adjacent(mask: Bools, cells: Cells) -> Nodes:
    """(M,) the flat cells of `mask` that share an edge with one of (N, 2) `cells`; some of them several times."""
    height, width = mask.shape
    found = np.empty(4 * len(cells), dtype=np.int64)
    count = 0
    for i in range(len(cells)):
        for k in range(4):
            r, c = cells[i, 0] + (k == 0) - (k == 1), cells[i, 1] + (k == 2) - (k == 3)
            if 0 <= r < height and 0 <= c < width and mask[r, c]:
                found[count] = r * width + c
                count += 1
    return found[:count]


def centre_cell(cells: Cells) -> tuple[int, int]:
    """The one of (N, 2) cells that is nearest to their mean."""
    row, col = _centre_cell(np.ascontiguousarray(cells))
    return int(row), int(col)


@numba.njit(cache=True, error_model="numpy")
def _centre_cell(cells: Cells) -> tuple[int, int]:
    n = len(cells)
    row, col = 0, 0
    for i in range(n):
        row, col = row + cells[i, 0], col + cells[i, 1]
    mean_row, mean_col = row / n, col / n
    best, nearest = 0, np.inf
    for i in range(n):
        away = (cells[i, 0] - mean_row) ** 2 + (cells[i, 1] - mean_col) ** 2
        if away < nearest:
            best, nearest = i, away
    return cells[best, 0], cells[best, 1]
