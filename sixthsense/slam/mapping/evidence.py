"""Evidence per cell: what is kept of each, in tiles that are allocated when a scan first touches them.

So memory follows what was seen, not the box around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import MAX_CELLS, SHIFT, TILE, Box
from sixthsense.slam.mapping.freespace import Bools

Ints = NDArray[np.int32]
Offsets = NDArray[np.int16]
Index = NDArray[np.int32]
"""(R, C) number of the tile in each square, -1 for none."""
Field = Literal["hits", "passes", "seen", "obstacles", "down", "across"]

SCANS_PER_STAMP = 126
"""scans that a stamp of one byte tells apart"""
MOST_RETURNS = 100
"""returns whose mean is kept of a cell; with more of them older ones count less"""
OFFSET = 1 << 15
"""an offset within a cell is kept in steps of a cell divided by this"""


class EvidenceRules(NamedTuple):
    """When a cell is an obstacle."""

    min_hits: int
    """fewest hits of an obstacle"""
    max_hits: int
    """further hits are not counted"""
    passes_per_hit: float
    """with more passes per hit than this the cell is free again"""

    @classmethod
    def of(cls, config: GridConfig) -> EvidenceRules:
        """Those of a configuration."""
        return cls(config.min_hits, config.max_hits, config.passes_per_hit)


class Cells(NamedTuple):
    """Flat arrays, tile after tile: what is kept of each cell."""

    hits: NDArray[Any]
    """scans that ended, or had a wall fitted, in the cell"""
    passes: Ints
    """scans that crossed the cell and did not hit it"""
    stamp: NDArray[np.uint8]
    """what the latest scan that reached the cell did to it; 0 if that was long ago"""
    seen: Bools
    """whether a beam has ever crossed the cell or ended in it"""
    obstacles: Bools
    """whether the evidence says occupied"""
    returns: NDArray[np.uint8]
    """returns in the cell, up to `MOST_RETURNS`"""
    down: Offsets
    """rows from the cell's centre to the mean of these returns, times `OFFSET`"""
    across: Offsets
    """the same of columns"""


class Tiles:
    """The evidence of all cells that were seen. Squares are places of tiles, row and column in the index."""

    def __init__(self, rules: EvidenceRules) -> None:
        """Begin without tiles and without an index."""
        self.first = (0, 0)
        """row, col of the first cell of the index, counted from the world's origin"""
        self.index: Index = np.full((0, 0), -1, dtype=np.int32)
        self.squares: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        """(T, 2) the square of each tile"""
        kinds = (np.min_scalar_type(rules.max_hits), "i4", "u1", "?", "?", "u1", "i2", "i2")
        self.cells = Cells(*(np.zeros(0, dtype=kind) for kind in kinds))
        """of all tiles"""
        self.rules = rules
        """when a cell is an obstacle"""

    def cover(self, box: Box) -> None:
        """Extend the index to a box of cells."""
        top, left, bottom, right = (edge // TILE for edge in box.aligned(TILE))
        old_top, old_left = (cell // TILE for cell in self.first) if self.index.size else (top, left)
        top, left = min(top, old_top), min(left, old_left)
        bottom, right = max(bottom, old_top + self.index.shape[0]), max(right, old_left + self.index.shape[1])
        if (bottom - top, right - left) == self.index.shape:
            return
        self.squares = self.squares + np.array([old_top - top, old_left - left])
        self.first, self.index = (top * TILE, left * TILE), np.full((bottom - top, right - left), -1, dtype=np.int32)
        self.index[tuple(self.squares.T)] = np.arange(len(self.squares))

    def allocate(self, wanted: Bools) -> None:
        """Allocate tiles in the squares (R, C) that are wanted and have none; InputError if these are too many."""
        new = np.argwhere(wanted & (self.index < 0))
        count = (len(self.squares) + len(new)) * TILE * TILE
        if count > MAX_CELLS:
            raise InputError("grid", f"found {count:,} cells that were seen", f"at most {MAX_CELLS:,} cells")
        self.index[tuple(new.T)] = np.arange(len(self.squares), len(self.squares) + len(new))
        self.squares = np.concatenate([self.squares, new])
        if count > len(self.cells.hits):
            room = max(count, len(self.cells.hits) // TILE**2 * 5 // 4 * TILE**2)
            array: NDArray[Any]
            for array in self.cells:
                array.resize(room, refcheck=False)  # in place: a copy would double the memory of a large map

    def slots(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N,) where cells (N, 2), row, col from the world's origin, are in the arrays; they are given tiles."""
        rows, cols = (cells - np.array(self.first)).T
        wanted = np.zeros(self.index.shape, dtype=np.bool_)
        wanted[rows >> SHIFT, cols >> SHIFT] = True
        self.allocate(wanted)
        tiles = self.index[rows >> SHIFT, cols >> SHIFT].astype(np.int64)
        return np.asarray((tiles << (2 * SHIFT)) + ((rows & (TILE - 1)) << SHIFT) + (cols & (TILE - 1)))

    def touched_by(self, boxes: Sequence[Box]) -> Bools:
        """(R, C) the squares that boxes touch."""
        height, width = self.index.shape
        squares = np.zeros((height, width), dtype=np.bool_)
        for box in boxes:
            rows, cols = box.aligned(TILE).within(self.first, (TILE * height, TILE * width))
            squares[rows.start >> SHIFT : rows.stop >> SHIFT, cols.start >> SHIFT : cols.stop >> SHIFT] = True
        return squares

    def erase(self, squares: Bools) -> None:
        """Remove the evidence in squares (R, C)."""
        tiles = self.index[squares & (self.index >= 0)]
        for array in self.cells:
            array.reshape(-1, TILE * TILE)[tiles] = 0

    def mark_obstacles(self, squares: Bools) -> None:
        """Mark the obstacles in squares (R, C) by their counts."""
        tiles = self.index[squares & (self.index >= 0)]
        arrays = self.cells.hits, self.cells.passes, self.cells.obstacles
        hits, passes, obstacles = (array.reshape(-1, TILE * TILE) for array in arrays)
        obstacles[tiles] = (hits[tiles] >= self.rules.min_hits) & (
            passes[tiles] <= self.rules.passes_per_hit * hits[tiles]
        )

    def part(self, array: NDArray[Any], box: Box) -> NDArray[Any]:
        """(H, W) what a flat array has of the cells in a box, 0 or False where there is no tile."""
        part = np.zeros((box.bottom - box.top, box.right - box.left), dtype=array.dtype)
        _copy(self.index, array, box.top - self.first[0], box.left - self.first[1], part)
        return part


@numba.njit(cache=True, error_model="numpy")
def slot(index: Index, row: int, col: int) -> int:
    """Where the cell at a row and column of the index is in the flat arrays; its square must have a tile."""
    tile = np.int64(index[row >> SHIFT, col >> SHIFT])
    return int((tile << (2 * SHIFT)) + ((row & (TILE - 1)) << SHIFT) + (col & (TILE - 1)))


@numba.njit(cache=True, error_model="numpy")
def _copy(index: Index, array: NDArray[Any], top: int, left: int, part: NDArray[Any]) -> None:
    """Copy the cells of (H, W) `part` from the tiles; its first cell is at row `top` and column `left` of the index."""
    height, width = part.shape
    rows, cols = index.shape
    for square_row in range(max(top >> SHIFT, 0), min(((top + height - 1) >> SHIFT) + 1, rows)):
        for square_col in range(max(left >> SHIFT, 0), min(((left + width - 1) >> SHIFT) + 1, cols)):
            tile = np.int64(index[square_row, square_col])
            if tile < 0:
                continue
            first_row, first_col = (square_row << SHIFT) - top, (square_col << SHIFT) - left
            for row in range(max(first_row, 0), min(first_row + TILE, height)):
                begin = (tile << (2 * SHIFT)) + ((row - first_row) << SHIFT) - first_col
                for col in range(max(first_col, 0), min(first_col + TILE, width)):
                    part[row, col] = array[begin + col]


class ScanCells(NamedTuple):
    """The cells (row, col in the index) that one scan touches."""

    laser: NDArray[np.int64]
    """(2,) cell of the laser"""
    ends: NDArray[np.int64]
    """(N, 2) where each beam ends"""
    returned: Bools
    """(N,) whether the beam ends at a return"""
    walls: NDArray[np.int64]
    """(2 W, 2) both ends of each wall"""
    fitted: int
    """walls, the first ones, that are drawn in any case; others are drawn where no beams have shown a way through"""
    end_points: Array
    """(N, 2) where each beam ends, row and col from the centre of the cell (0, 0), in cells"""


@numba.njit(cache=True, error_model="numpy")
def line_cells(r0: int, c0: int, r1: int, c1: int) -> NDArray[np.int64]:
    """(N, 2) cells of Bresenham's line from (r0, c0) to (r1, c1), both ends included."""
    down, across = abs(r1 - r0), abs(c1 - c0)
    row_step, col_step = 1 if r1 > r0 else -1, 1 if c1 > c0 else -1
    is_steep = down > across
    major, minor = (down, across) if is_steep else (across, down)
    cells = np.empty((major + 1, 2), dtype=np.int64)
    row, col, error = r0, c0, major // 2
    for k in range(major + 1):
        cells[k, 0], cells[k, 1] = row, col
        error -= minor
        is_diagonal = error < 0
        if is_diagonal:
            error += major
        row += row_step * (is_steep or is_diagonal)
        col += col_step * (not is_steep or is_diagonal)
    return cells


@numba.njit(cache=True, error_model="numpy")
def _hit(cells: Cells, cell: int, mark: int, rules: EvidenceRules) -> None:
    """Count a hit, once per scan."""
    if cells.stamp[cell] == mark:
        return
    cells.stamp[cell] = mark
    cells.hits[cell] = min(cells.hits[cell] + 1, rules.max_hits)
    # However long a cell has been free: a robot that sees an obstacle there now must not run into it.
    cells.passes[cell] = min(cells.passes[cell], int(rules.passes_per_hit * cells.hits[cell]))
    cells.obstacles[cell] = cells.hits[cell] >= rules.min_hits


@numba.njit(cache=True, error_model="numpy")
def _add_return(cells: Cells, cell: int, down: float, across: float) -> None:
    """Count a return in a cell, at an offset from its centre."""
    count = min(cells.returns[cell] + 1, MOST_RETURNS)
    cells.returns[cell] = count
    cells.down[cell] += np.int16(round((OFFSET * down - cells.down[cell]) / count))
    cells.across[cell] += np.int16(round((OFFSET * across - cells.across[cell]) / count))


@numba.njit(cache=True, error_model="numpy")
def count_scan(cells: Cells, index: Index, scan: ScanCells, number: int, rules: EvidenceRules) -> None:
    """Count one scan in the tiles of `index`.

    `number` is that of the scan, 1 to `SCANS_PER_STAMP`, and not that of another one since stamps were 0.
    """
    laser, ends, returned, walls = scan.laser, scan.ends, scan.returned, scan.walls
    passed, hit = 2 * number, 2 * number + 1  # stamps of this scan
    for i in range(len(ends)):
        cell = slot(index, ends[i, 0], ends[i, 1])
        cells.seen[cell] = True
        if returned[i]:
            _hit(cells, cell, hit, rules)
            _add_return(cells, cell, scan.end_points[i, 0] - ends[i, 0], scan.end_points[i, 1] - ends[i, 1])
    for j in range(0, len(walls), 2):
        line = line_cells(walls[j, 0], walls[j, 1], walls[j + 1, 0], walls[j + 1, 1])
        for k in range(len(line)):
            cell = slot(index, line[k, 0], line[k, 1])
            if j < 2 * scan.fitted or cells.passes[cell] <= rules.passes_per_hit * cells.hits[cell]:
                _hit(cells, cell, hit, rules)
    for i in range(len(ends)):
        line = line_cells(laser[0], laser[1], ends[i, 0], ends[i, 1])
        for k in range(len(line) - 1 if returned[i] else len(line)):
            cell = slot(index, line[k, 0], line[k, 1])
            if cells.stamp[cell] == passed:
                continue
            cells.seen[cell] = True
            if cells.stamp[cell] == hit:
                continue
            cells.stamp[cell] = passed
            cells.passes[cell] += 1
            if cells.passes[cell] > rules.passes_per_hit * cells.hits[cell]:
                cells.obstacles[cell] = False
