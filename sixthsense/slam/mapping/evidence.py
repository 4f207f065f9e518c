"""Evidence per cell: how one scan's beams and walls are counted."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import SHIFT
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.tiles import ROW, Index, Places, slot

Ints = NDArray[np.int32]
SCANS_PER_STAMP = 126
"""scans that a stamp of one byte tells apart"""
Offsets = NDArray[np.int16]
MOST_RETURNS = 100
"""returns whose mean is kept of a cell; with more of them older ones count less"""
OFFSET = 1 << 15
"""an offset within a cell is kept in steps of a cell divided by this"""


class Cells(NamedTuple):
    """Flat arrays, tile after tile: what is kept of each cell."""

    hits: NDArray[Any]
    """scans that ended, or had a wall fitted, in the cell"""
    passes: Ints
    """scans that crossed the cell and did not hit it"""
    cover: NDArray[Any]
    """obstacles whose inflation covers the cell"""
    stamp: NDArray[np.uint8]
    """what the latest scan that reached the cell did to it; 0 if that was long ago"""
    seen: Bools
    """whether a beam has ever crossed the cell or ended in it"""
    obstacles: Bools
    """whether the evidence says occupied"""
    returns: NDArray[np.uint8]
    """returns in the cell, up to `MOST_RETURNS`"""
    down: Offsets
    """rows from the cell's centre to the mean of these returns, times `OFFSET`; without any to a fitted wall"""
    across: Offsets
    """the same of columns"""

    @classmethod
    def empty(cls, count: int, max_hits: int, most_cover: int) -> Cells:
        """Cells without evidence, of types that hold so many hits, and so many obstacles that cover a cell."""
        types = np.min_scalar_type(max_hits), np.int32, np.result_type(np.int16, np.min_scalar_type(-most_cover))
        hits, passes, cover = (np.zeros(count, dtype=kind) for kind in types)
        seen, obstacles = (np.zeros(count, dtype=np.bool_) for _ in range(2))
        down, across = (np.zeros(count, dtype=np.int16) for _ in range(2))
        stamp, returns = (np.zeros(count, dtype=np.uint8) for _ in range(2))
        return cls(hits, passes, cover, stamp, seen, obstacles, returns, down, across)

    def extend(self, count: int) -> None:
        """Make room for more cells behind these, in place: a copy would double the memory of a large map."""
        array: NDArray[Any]
        for array in self:
            array.resize(count, refcheck=False)  # no view of them outlives a call


class EvidenceRules(NamedTuple):
    """When a cell is an obstacle."""

    min_hits: int
    """fewest hits of an obstacle"""
    max_hits: int
    """further hits are not counted"""
    passes_per_hit: float
    """with more passes per hit than this the cell is free again"""


def are_obstacles(hits: Ints, passes: Ints, config: GridConfig) -> Bools:
    """Which cells are obstacles by these counts, arrays of one shape."""
    return np.asarray((hits >= config.min_hits) & (passes <= config.passes_per_hit * hits))


class ScanCells(NamedTuple):
    """The cells (row, col from the first of the index) that one scan touches."""

    laser: NDArray[np.int64]
    """(2,) cell of the laser"""
    ends: NDArray[np.int64]
    """(N, 2) where each beam ends"""
    returned: Bools
    """(N,) whether the beam ends at a return"""
    walls: NDArray[np.int64]
    """(2 W, 2) both ends of each fitted wall"""
    end_points: Array
    """(N, 2) where each beam ends, row and col from the centre of the cell (0, 0), in cells"""
    wall_points: Array
    """(2 W, 2) both ends of each fitted wall in the same way"""


@numba.njit(cache=True, error_model="numpy")
def line_places(r0: int, c0: int, r1: int, c1: int) -> Places:
    """(N,) places of Bresenham's line from the cell (r0, c0) to (r1, c1), both ends included."""
    down, across = abs(r1 - r0), abs(c1 - c0)
    row_step, col_step = ROW if r1 > r0 else -ROW, 1 if c1 > c0 else -1
    major, minor, major_step, minor_step = across, down, col_step, row_step
    if down > across:
        major, minor, major_step, minor_step = down, across, row_step, col_step
    places = np.empty(major + 1, dtype=np.int64)
    place, error = r0 * ROW + c0, major // 2
    for k in range(major + 1):
        places[k] = place
        place += major_step
        error -= minor
        if error < 0:
            place += minor_step
            error += major
    return places


@numba.njit(cache=True, error_model="numpy")
def touched_squares(scan: ScanCells, reach: int, first: tuple[int, int], squares: Bools) -> None:
    """Mark the squares (R, C) that a scan passes, or that obstacles of it cover with a disc of `reach`.

    `squares` begins at the square `first` of the index.
    """
    laser, ends, walls = scan.laser, scan.ends, scan.walls
    for i in range(len(ends)):
        line = line_places(laser[0], laser[1], ends[i, 0], ends[i, 1])
        for place in line:
            squares[(place >> (32 + SHIFT)) - first[0], ((place & 0xFFFFFFFF) >> SHIFT) - first[1]] = True
        if scan.returned[i]:
            _mark_around(squares, ends[i, 0] - (first[0] << SHIFT), ends[i, 1] - (first[1] << SHIFT), reach)
    for j in range(0, len(walls), 2):
        for place in line_places(walls[j, 0], walls[j, 1], walls[j + 1, 0], walls[j + 1, 1]):
            row, col = (place >> 32) - (first[0] << SHIFT), (place & 0xFFFFFFFF) - (first[1] << SHIFT)
            _mark_around(squares, row, col, reach)


@numba.njit(cache=True, error_model="numpy")
def _mark_around(squares: Bools, row: int, col: int, reach: int) -> None:
    for r in range((row - reach) >> SHIFT, ((row + reach) >> SHIFT) + 1):
        for c in range((col - reach) >> SHIFT, ((col + reach) >> SHIFT) + 1):
            squares[r, c] = True


@numba.njit(cache=True, error_model="numpy")
def _hit(cells: Cells, index: Index, place: int, mark: int, stencil: Places, rules: EvidenceRules) -> None:
    """Count a hit, once per scan, and inflate the cell if that makes it an obstacle."""
    cell = slot(index, place)
    if cells.stamp[cell] == mark:
        return
    cells.stamp[cell] = mark
    cells.hits[cell] = min(cells.hits[cell] + 1, rules.max_hits)
    # However long a cell has been free: a robot that sees an obstacle there now must not run into it.
    cells.passes[cell] = min(cells.passes[cell], int(rules.passes_per_hit * cells.hits[cell]))
    if not cells.obstacles[cell] and cells.hits[cell] >= rules.min_hits:
        cells.obstacles[cell] = True
        for offset in stencil:
            cells.cover[slot(index, place + offset)] += 1


@numba.njit(cache=True, error_model="numpy")
def _add_return(cells: Cells, cell: int, down: float, across: float) -> None:
    """Count a return in a cell, at an offset from its centre."""
    count = min(cells.returns[cell] + 1, MOST_RETURNS)
    cells.returns[cell] = count
    cells.down[cell] += np.int16(round((OFFSET * down - cells.down[cell]) / count))
    cells.across[cell] += np.int16(round((OFFSET * across - cells.across[cell]) / count))


@numba.njit(cache=True, error_model="numpy")
def _nearest_on_wall(wall: Array, row: int, col: int) -> tuple[float, float]:
    """The offset from a cell's centre to the nearest point of a wall (2, 2) that is within the cell."""
    down, across = wall[1, 0] - wall[0, 0], wall[1, 1] - wall[0, 1]
    length_sq = down * down + across * across
    share = 0.0
    if length_sq > 0.0:
        share = ((row - wall[0, 0]) * down + (col - wall[0, 1]) * across) / length_sq
        share = min(max(share, 0.0), 1.0)
    to_row, to_col = wall[0, 0] + share * down - row, wall[0, 1] + share * across - col
    return min(max(to_row, -0.5), 0.5), min(max(to_col, -0.5), 0.5)


@numba.njit(cache=True, error_model="numpy")
def count_scan(cells: Cells, index: Index, scan: ScanCells, number: int, stencil: Places, rules: EvidenceRules) -> None:
    """Count one scan in the tiles of `index`; `stencil` (K,) are offsets of places.

    `number` is that of the scan, 1 to `SCANS_PER_STAMP`, and not that of another one since stamps were 0.
    """
    laser, ends, returned, walls = scan.laser, scan.ends, scan.returned, scan.walls
    passed, hit = 2 * number, 2 * number + 1  # stamps of this scan
    for i in range(len(ends)):
        place = ends[i, 0] * ROW + ends[i, 1]
        cells.seen[slot(index, place)] = True
        if returned[i]:
            _hit(cells, index, place, hit, stencil, rules)
            down, across = scan.end_points[i, 0] - ends[i, 0], scan.end_points[i, 1] - ends[i, 1]
            _add_return(cells, slot(index, place), down, across)
    for j in range(0, len(walls), 2):
        for place in line_places(walls[j, 0], walls[j, 1], walls[j + 1, 0], walls[j + 1, 1]):
            _hit(cells, index, place, hit, stencil, rules)
            cell = slot(index, place)
            if cells.returns[cell] == 0:
                down, across = _nearest_on_wall(scan.wall_points[j : j + 2], place >> 32, place & 0xFFFFFFFF)
                cells.down[cell], cells.across[cell] = round(OFFSET * down), round(OFFSET * across)
    for i in range(len(ends)):
        line = line_places(laser[0], laser[1], ends[i, 0], ends[i, 1])
        for place in line[: len(line) - 1] if returned[i] else line:
            cell = slot(index, place)
            if cells.stamp[cell] == passed:
                continue
            cells.seen[cell] = True
            if cells.stamp[cell] == hit:
                continue
            cells.stamp[cell] = passed
            cells.passes[cell] += 1
            if cells.obstacles[cell] and cells.passes[cell] > rules.passes_per_hit * cells.hits[cell]:
                cells.obstacles[cell] = False
                for offset in stencil:
                    cells.cover[slot(index, place + offset)] -= 1
