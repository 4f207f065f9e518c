"""What is left to see, and from where: frontiers, ways, viewpoints and what they would show, on the cells of a grid.

Masks are (H, W), indexed [row = y, col = x]; lengths are in cells. A frontier is a cell that was seen and is free,
beside one that was not seen and is wanted (Yamauchi, CIRA 1997).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import Bools

Cells = NDArray[np.int64]
Costs = NDArray[np.float32]

_SQRT2 = math.sqrt(2.0)
_EIGHT = np.ones((3, 3), dtype=np.bool_)
_RING = 8  # buckets, each a quarter of a cell wide: a step is at most sqrt 2


def frontier_cells(free: Bools, unseen: Bools) -> Bools:
    """The cells of `free` that share an edge with one of `unseen`."""
    beside = np.zeros_like(free)
    beside[1:] |= unseen[:-1]
    beside[:-1] |= unseen[1:]
    beside[:, 1:] |= unseen[:, :-1]
    beside[:, :-1] |= unseen[:, 1:]
    beside &= free
    return beside


def frontier_points(
    seen: Bools, obstacles: Bools, origin: tuple[float, float], cell_m: float, region: tuple[float, ...] | None
) -> Array:
    """(N, 2) centres of the frontiers, however small, world frame, metres.

    `seen` and `obstacles` (H, W) have their lower left corner at `origin`; what is unseen outside `region`
    (x0, y0, x1, y1) is no frontier. Gaps of a cell or two in obstacles are closed.
    """
    closed = without_gaps(obstacles)
    unseen = ~(seen | closed)
    if region is not None:
        x0, y0, x1, y1 = region
        y = origin[1] + (np.arange(seen.shape[0]) + 0.5) * cell_m
        x = origin[0] + (np.arange(seen.shape[1]) + 0.5) * cell_m
        unseen &= ((y > y0) & (y < y1))[:, None] & ((x > x0) & (x < x1))[None, :]
    edge = np.argwhere(frontier_cells(seen & ~closed, unseen))
    return np.asarray((edge[:, ::-1] + 0.5) * cell_m + np.array(origin))


def without_gaps(obstacles: Bools) -> Bools:
    """`obstacles` closed by a square of 3 cells: a gap of one or two cells in a wall is noise, and shows nothing."""
    return _eroded(_dilated(np.pad(obstacles, 2)))[2:-2, 2:-2]


def _dilated(mask: Bools) -> Bools:
    wide = mask.copy()
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    high = wide.copy()
    high[1:] |= wide[:-1]
    high[:-1] |= wide[1:]
    return high


def _eroded(mask: Bools) -> Bools:
    return ~_dilated(~mask)


def connected(free: Bools, row: int, col: int) -> Bools:
    """The cells of `free` that are connected, edge to edge, to a cell."""
    labels, _ = ndimage.label(free)
    return np.asarray(labels == labels[row, col]) if labels[row, col] else np.zeros_like(free)


def without_dust(unseen: Bools, edge: Bools, cells: float) -> tuple[Bools, Bools]:
    """`unseen` without its smallest pieces, up to so many `cells` in all, and the part of `edge` beside the rest.

    A piece is connected edge to edge; one that has no cell of `edge` beside it could not be seen, and stays.
    """
    labels, count = ndimage.label(unseen)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    beside = np.unique(labels[frontier_cells(unseen, edge)])
    order = beside[np.argsort(sizes[beside], kind="stable")]
    dust = np.zeros(count + 1, dtype=np.bool_)
    dust[order[np.cumsum(sizes[order]) <= cells]] = True
    rest = unseen & ~dust[labels]
    return rest, frontier_cells(edge, rest)


def clusters(frontier: Bools, tile: int) -> list[Cells]:
    """The cells (N, 2), row and col, of each connected piece of `frontier` within each square of `tile` cells."""
    labels, _ = ndimage.label(frontier, _EIGHT)
    cells = np.argwhere(frontier)
    squares = cells // tile
    keys = np.stack([labels[frontier], squares[:, 0], squares[:, 1]], axis=1)
    order = np.lexsort(keys.T)
    keys, cells = keys[order], cells[order]
    starts = np.flatnonzero((np.diff(keys, axis=0) != 0).any(axis=1)) + 1
    return [cells[a:b] for a, b in zip([0, *starts], [*starts, len(cells)], strict=True)] if len(cells) else []


@numba.njit(cache=True, error_model="numpy")
def ways(passable: Bools, blocked: Bools, row: int, col: int) -> Costs:
    """(H, W) lengths of the shortest 8-connected ways over `passable` from a cell, inf where none leads.

    A diagonal step cuts no corner of a `blocked` cell. Dijkstra's search with a ring of buckets a quarter of a cell
    wide, in which a cell that improves after its expansion is expanded again.
    """
    height, width = passable.shape
    cost = np.full((height, width), np.float32(np.inf))
    stacks = np.empty((_RING, 1024), dtype=np.int64)
    sizes = np.zeros(_RING, dtype=np.int64)
    cost[row, col] = 0.0
    stacks[0, 0] = row * width + col
    sizes[0] = 1
    queued, bucket = 1, 0
    while queued > 0:
        while sizes[bucket % _RING] == 0:
            bucket += 1
        slot = bucket % _RING
        sizes[slot] -= 1
        queued -= 1
        cell = stacks[slot, sizes[slot]]
        r, c = cell // width, cell % width
        here = cost[r, c]
        if int(4.0 * here) < bucket:
            continue  # reached by a shorter way since
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                to_r, to_c = r + dr, c + dc
                if not (0 <= to_r < height and 0 <= to_c < width) or not passable[to_r, to_c]:
                    continue
                if dr != 0 and dc != 0 and (blocked[r, to_c] or blocked[to_r, c]):
                    continue
                there = np.float32(here + (_SQRT2 if dr != 0 and dc != 0 else 1.0))
                if there >= cost[to_r, to_c] - np.float32(1e-3):
                    continue
                cost[to_r, to_c] = there
                slot = int(4.0 * there) % _RING
                if sizes[slot] == stacks.shape[1]:
                    wider = np.empty((_RING, 2 * stacks.shape[1]), dtype=np.int64)
                    wider[:, : stacks.shape[1]] = stacks
                    stacks = wider
                stacks[slot, sizes[slot]] = to_r * width + to_c
                sizes[slot] += 1
                queued += 1
    return cost


@numba.njit(cache=True, error_model="numpy")
def in_view(obstacles: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether no cell of `obstacles` is between the centres of two cells.

    Cells are walked edge to edge (Amanatides and Woo 1987), so that no ray slips through a wall of cells that touch at
    their corners.
    """
    rows, cols = abs(to_row - row), abs(to_col - col)
    step_row, step_col = (1 if to_row > row else -1), (1 if to_col > col else -1)
    # Twice the distances to the next edges, times rows and cols: whole numbers.
    ahead_row, ahead_col = cols, rows
    for _ in range(rows + cols - 1):
        if rows == 0 or (cols > 0 and ahead_col < ahead_row):
            col += step_col
            ahead_col += 2 * rows
        else:
            row += step_row
            ahead_row += 2 * cols
        if obstacles[row, col]:
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def viewpoint(cost: Costs, obstacles: Bools, row: int, col: int, reach: float) -> int:
    """The flat index of the nearest cell with finite `cost` from which a cell is in view within `reach`; -1 if none.

    Squares around the cell are walked outwards, until no cell beyond can be nearer.
    """
    height, width = cost.shape
    best, found = reach + 1e-9, -1
    for ring in range(int(reach) + 1):
        if ring > best:
            break
        for r in range(max(row - ring, 0), min(row + ring, height - 1) + 1):
            step = 1 if abs(r - row) == ring else max(2 * ring, 1)
            for c in range(col - ring, col + ring + 1, step):
                if not 0 <= c < width or cost[r, c] == np.inf:
                    continue
                away = math.hypot(r - row, c - col)
                if away < best and in_view(obstacles, r, c, row, col):
                    best, found = away, r * width + c
    return found


@numba.njit(cache=True, error_model="numpy")
def beside(wanted: Bools, cells: Cells) -> Cells:
    """(M, 2) the cells of `wanted` that share an edge with one of (N, 2) `cells`, each once."""
    height, width = wanted.shape
    found = np.empty(4 * len(cells), dtype=np.int64)
    count = 0
    for i in range(len(cells)):
        for k in range(4):
            r, c = cells[i, 0] + (k == 0) - (k == 1), cells[i, 1] + (k == 2) - (k == 3)
            if 0 <= r < height and 0 <= c < width and wanted[r, c]:
                found[count] = r * width + c
                count += 1
    once = np.unique(found[:count])
    out = np.empty((len(once), 2), dtype=np.int64)
    out[:, 0], out[:, 1] = once // width, once % width
    return out


@numba.njit(cache=True, error_model="numpy")
def gain(
    obstacles: Bools, unseen: Bools, row: int, col: int, rays: int, reach: float, depth: int, stamp: Cells, mark: int
) -> int:
    """How many cells of `unseen` so many rays from a cell's centre cross, evenly all around and `reach` long.

    A ray ends at an obstacle, and after `depth` unseen cells: what lies deep in the unknown is probably not in view.
    `stamp` (H, W) is scratch space, in which no cell holds `mark` yet.
    """
    height, width = obstacles.shape
    count = 0
    for i in range(rays):
        angle = 2.0 * math.pi * i / rays
        cos, sin = math.cos(angle), math.sin(angle)
        r, c = row, col
        step_r, step_c = (1 if sin > 0.0 else -1), (1 if cos > 0.0 else -1)
        per_r, per_c = abs(1.0 / sin), abs(1.0 / cos)
        next_r, next_c = 0.5 * per_r, 0.5 * per_c
        left = depth
        while left > 0:
            if next_c < next_r:
                at = next_c
                c += step_c
                next_c += per_c
            else:
                at = next_r
                r += step_r
                next_r += per_r
            if at > reach or not (0 <= r < height and 0 <= c < width) or obstacles[r, c]:
                break
            if unseen[r, c]:
                left -= 1
                if stamp[r, c] != mark:
                    stamp[r, c] = mark
                    count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def cells_in_view(obstacles: Bools, wanted: Bools, row: int, col: int, reach: float) -> Bools:
    """(H, W) the cells of `wanted` that are in view from a cell within `reach`."""
    height, width = wanted.shape
    seen = np.zeros((height, width), dtype=np.bool_)
    span = int(reach)
    for r in range(max(row - span, 0), min(row + span + 1, height)):
        for c in range(max(col - span, 0), min(col + span + 1, width)):
            if wanted[r, c] and math.hypot(r - row, c - col) <= reach:
                seen[r, c] = in_view(obstacles, row, col, r, c)
    return seen


def before_gap(cost: Costs, fitting: Costs, row: int, col: int) -> tuple[int, int] | None:
    """The last cell with finite `cost` on the way to a cell that only `fitting` reaches.

    `fitting` (H, W) are the ways through gaps that are closed to `cost`. None if the cell is reached by both or by
    neither, or if the way has no cell with finite `cost`.
    """
    if not np.isfinite(fitting[row, col]) or np.isfinite(cost[row, col]):
        return None
    while not np.isfinite(cost[row, col]):
        top, left = max(row - 1, 0), max(col - 1, 0)
        around = fitting[top : row + 2, left : col + 2]
        down, right = divmod(int(np.argmin(around)), around.shape[1])
        if around[down, right] >= fitting[row, col]:
            return None
        row, col = top + down, left + right
    return row, col


def dense_reach(spacing_rad: float, max_range_cells: float) -> float:
    """How far, in cells, beams so far apart leave no gap as wide as a cell; with slack, within the laser's range."""
    return min(0.8 / max(spacing_rad, 1e-9), 0.95 * max_range_cells)


def centre_cell(cells: Array | Cells) -> tuple[int, int]:
    """Of (N, 2) cells the one nearest to their mean."""
    k = int(np.argmin(((cells - cells.mean(axis=0)) ** 2).sum(axis=1)))
    return int(cells[k, 0]), int(cells[k, 1])
