"""Connected regions beside a frontier, followed no further than their size matters.

Masks are (H, W), indexed [row = y, col = x]. Regions are connected edge to edge. The cost follows the frontier and the
size that is asked for, not the map.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.prices import appended
from sixthsense.navigation.gridsearch.reached import join, root_of
from sixthsense.slam.mapping.freespace import Bools

Cells = NDArray[np.int64]
"""(N, 2) row, col."""
Nodes = NDArray[np.int64]
"""(N,) flat indices, row * width + col."""
Marks = NDArray[np.uint8]
"""(H, W) what is known of the cells' regions."""

_LARGE, _SMALL, _OPEN = np.uint8(1), np.uint8(2), np.uint8(3)


def spread(mask: Bools, allowed: Bools, steps: int, inside: tuple[int, int, int, int]) -> Bools:
    """`mask` and the cells of `allowed` that at most `steps` steps, edge to edge over `allowed`, lead to from it.

    Inside the rows and columns `inside` (first row, past row, first column, past column) all of `allowed` is in `mask`.
    """
    wider = mask.copy()
    top, below, left, right = inside
    height, width = mask.shape
    frame = [(0, top, 0, width), (top, below, 0, left), (top, below, right, width), (below, height, 0, width)]
    first = [_beside_mask(wider, allowed, part) for part in frame]
    _spread(wider, allowed, steps, np.concatenate(first))
    return wider


def _beside_mask(mask: Bools, allowed: Bools, part: tuple[int, int, int, int]) -> Nodes:
    """The cells of `allowed` within some rows and columns that are not in `mask` and share an edge with it."""
    top, below, left, right = part
    rows, cols = slice(max(top - 1, 0), below + 1), slice(max(left - 1, 0), right + 1)
    around = mask[rows, cols]
    beside = frontier_cells(allowed[rows, cols] & ~around, around)
    r, c = np.nonzero(beside[top - rows.start :, left - cols.start :][: below - top, : right - left])
    return np.asarray((r + top) * mask.shape[1] + c + left)


def frontier_cells(free: Bools, unseen: Bools) -> Bools:
    """(H, W) the cells of `free` that share an edge with one of `unseen`."""
    beside = np.zeros_like(free)
    beside[1:] |= unseen[:-1]
    beside[:-1] |= unseen[1:]
    beside[:, 1:] |= unseen[:, :-1]
    beside[:, :-1] |= unseen[:, 1:]
    beside &= free
    return beside


@numba.njit(cache=True, error_model="numpy")
def _spread(mask: Bools, allowed: Bools, steps: int, cells: Nodes) -> None:
    """Add to `mask` the `cells` and those of `allowed` up to `steps` - 1 steps away from them, breadth first."""
    height, width = mask.shape
    for step in range(steps):
        found = np.empty(4 * len(cells), dtype=np.int64)
        count = 0
        for cell in cells:
            mask[cell // width, cell % width] = True
        for cell in cells:
            r, c = cell // width, cell % width
            for k in range(4):
                to_r, to_c = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
                if 0 <= to_r < height and 0 <= to_c < width and allowed[to_r, to_c] and not mask[to_r, to_c]:
                    if step + 1 < steps:
                        mask[to_r, to_c] = True
                    found[count] = to_r * width + to_c
                    count += 1
        cells = found[:count]


@numba.njit(cache=True, error_model="numpy")
def are_beside(mask: Bools, cells: Cells) -> Bools:
    """(N,) which of `cells` share an edge with one of `mask`."""
    beside = np.empty(len(cells), dtype=np.bool_)
    for i in range(len(cells)):
        beside[i] = _beside(mask, cells[i, 0], cells[i, 1])
    return beside


def in_large_regions(free: Bools, cells: Cells, least: int, here: tuple[int, int]) -> Bools:
    """(N,) which of `cells`, all in `free`, lie in regions of at least `least` cells or in that of the cell `here`."""
    marks = np.zeros(free.shape, dtype=np.uint8)
    return np.asarray(_in_large_regions(free, cells, least, here, marks))


@numba.njit(cache=True, error_model="numpy")
def _in_large_regions(free: Bools, cells: Cells, least: int, here: tuple[int, int], marks: Marks) -> Bools:
    width = free.shape[1]
    is_large = np.zeros(len(cells), dtype=np.bool_)
    region = np.empty(least + 4, dtype=np.int64)
    if free[here]:
        count, _ = _follow(free, marks, here[0] * width + here[1], least, region)
        for i in range(count):
            marks[region[i] // width, region[i] % width] = _LARGE
    for k in range(len(cells)):
        r, c = cells[k]
        if marks[r, c] == 0:
            count, meets = _follow(free, marks, r * width + c, least, region)
            mark = _LARGE if meets or count >= least else _SMALL
            for i in range(count):
                marks[region[i] // width, region[i] % width] = mark
        is_large[k] = marks[r, c] == _LARGE
    return is_large


def small_regions(mask: Bools, beside: Cells, most: int) -> tuple[Nodes, Nodes]:
    """The regions of `mask` of at most `most` cells that share an edge with one of `beside`.

    Flat indices of their cells, region after region, and (R,) where each ends.
    """
    return _small_regions(mask, beside, most, np.zeros(mask.shape, dtype=np.uint8))


@numba.njit(cache=True, error_model="numpy")
def _small_regions(mask: Bools, beside: Cells, most: int, marks: Marks) -> tuple[Nodes, Nodes]:
    """The cells of the regions, one after the other, and (R,) where each ends."""
    height, width = mask.shape
    found, ends = np.empty(1024, dtype=np.int64), np.empty(1024, dtype=np.int64)
    size, regions = 0, 0
    region = np.empty(most + 5, dtype=np.int64)
    for k in range(len(beside)):
        for step in range(4):
            r = beside[k, 0] + (step == 0) - (step == 1)
            c = beside[k, 1] + (step == 2) - (step == 3)
            if not (0 <= r < height and 0 <= c < width) or not mask[r, c] or marks[r, c] != 0:
                continue
            count, meets = _follow(mask, marks, r * width + c, most + 1, region)
            is_small = not meets and count <= most
            for i in range(count):
                marks[region[i] // width, region[i] % width] = _SMALL if is_small else _LARGE
            if is_small:
                for i in range(count):
                    found, size = appended(found, size, region[i])
                ends, regions = appended(ends, regions, size)
    return found[:size].copy(), ends[:regions].copy()


@numba.njit(cache=True, error_model="numpy")
def _follow(mask: Bools, marks: Marks, start: int, enough: int, region: Nodes) -> tuple[int, bool]:
    """Collect the cells of a region in `region` until they are `enough` or a cell of a marked region is met.

    Returns how many, and whether one was met. The cells collected are marked as open.
    """
    height, width = mask.shape
    region[0], count, i = start, 1, 0
    marks[start // width, start % width] = _OPEN
    while i < count and count < enough:
        r, c = region[i] // width, region[i] % width
        for k in range(4):
            to_r, to_c = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
            if not (0 <= to_r < height and 0 <= to_c < width) or not mask[to_r, to_c]:
                continue
            if marks[to_r, to_c] == 0:
                marks[to_r, to_c] = _OPEN
                region[count] = to_r * width + to_c
                count += 1
            elif marks[to_r, to_c] != _OPEN:
                return count, True
        i += 1
    return count, False


@numba.njit(cache=True, error_model="numpy")
def joined(cells: Cells) -> NDArray[np.int64]:
    """(N,) the number of the 8-connected part that each cell of (N, 2) `cells`, row by row, is in.

    Parts are numbered by their first cells. Each cell joins those before it that it touches.
    """
    root = np.arange(len(cells))
    above = 0  # the first cell that may touch the present one from the row above
    for i in range(len(cells)):
        r, c = cells[i]
        if i > 0 and cells[i - 1, 0] == r and cells[i - 1, 1] == c - 1:
            join(root, i - 1, i)
        while cells[above, 0] < r - 1 or (cells[above, 0] == r - 1 and cells[above, 1] < c - 1):
            above += 1
        j = above
        while cells[j, 0] == r - 1 and cells[j, 1] <= c + 1:
            join(root, j, i)
            j += 1
    part = np.empty(len(cells), dtype=np.int64)
    parts = 0
    for i in range(len(cells)):
        first = root_of(root, i)
        if first == i:
            part[i] = parts
            parts += 1
        else:
            part[i] = part[first]
    return part


@numba.njit(cache=True, error_model="numpy")
def _beside(mask: Bools, r: int, c: int) -> bool:
    """Whether a cell shares an edge with one of `mask`."""
    height, width = mask.shape
    return bool(
        (r > 0 and mask[r - 1, c])
        or (r + 1 < height and mask[r + 1, c])
        or (c > 0 and mask[r, c - 1])
        or (c + 1 < width and mask[r, c + 1])
    )
