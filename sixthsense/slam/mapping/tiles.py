"""Tiles: cells in squares that are allocated when a scan first touches them, so that memory follows what was seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.changes import SHIFT, TILE, Box

ROW = 1 << 32
"""A place is row * 2^32 + col, counted from the first cell of the index; offsets of places add up."""

Places = NDArray[np.int64]
Index = NDArray[np.int32]
"""(R, C) number of the tile in each square, -1 for none."""


class Tiles:
    """Where each tile's cells are in the flat arrays that hold the cells of all tiles, one tile after the other."""

    def __init__(self) -> None:
        """Begin without tiles and without an index."""
        self.first = (0, 0)
        """row, col of the first cell of the index, counted from the world's origin"""
        self.index: Index = np.full((0, 0), -1, dtype=np.int32)
        self.squares: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        """(T, 2) row and column of each tile in the index"""

    def cover(self, box: Box) -> None:
        """Extend the index to a box of cells."""
        top, left = (math.floor(cell / TILE) for cell in (box.top, box.left))
        bottom, right = (math.ceil(cell / TILE) for cell in (box.bottom, box.right))
        if self.index.size:
            old_top, old_left = self.first[0] // TILE, self.first[1] // TILE
            top, left = min(top, old_top), min(left, old_left)
            bottom, right = max(bottom, old_top + self.index.shape[0]), max(right, old_left + self.index.shape[1])
        else:
            old_top, old_left = top, left
        if (bottom - top, right - left) == self.index.shape:
            return
        index = np.full((bottom - top, right - left), -1, dtype=np.int32)
        self.squares = self.squares + np.array([old_top - top, old_left - left])
        index[tuple(self.squares.T)] = np.arange(len(self.squares))
        self.first, self.index = (top * TILE, left * TILE), index

    def lacking(self, wanted: NDArray[np.bool_], first: tuple[int, int]) -> NDArray[np.int64]:
        """(N, 2) the squares that are wanted and have no tile; `wanted` (R, C) begins at the square `first`."""
        rows, cols = wanted.shape
        index = self.index[first[0] : first[0] + rows, first[1] : first[1] + cols]
        return np.asarray(np.argwhere(wanted & (index < 0)) + np.array(first))

    def allocate(self, new: NDArray[np.int64]) -> None:
        """Give tiles to squares (N, 2) that have none."""
        self.index[tuple(new.T)] = np.arange(len(self.squares), len(self.squares) + len(new))
        self.squares = np.concatenate([self.squares, new])

    def places(self, cells: NDArray[np.int64]) -> Places:
        """(N,) the places of cells (N, 2), row, col from the world's origin."""
        return np.asarray((cells[:, 0] - self.first[0]) * ROW + (cells[:, 1] - self.first[1]))

    def slots(self, places: Places) -> NDArray[np.int64]:
        """(N,) where the cells at places are in the flat arrays; their squares must have tiles."""
        rows, cols = places // ROW, places % ROW
        tiles = self.index[rows >> SHIFT, cols >> SHIFT].astype(np.int64)
        return np.asarray((tiles << (2 * SHIFT)) + ((rows & (TILE - 1)) << SHIFT) + (cols & (TILE - 1)))

    def around(self, places: Places, reach: int) -> NDArray[np.bool_]:
        """(R, C) the squares that cells up to `reach` rows and columns from (N,) places lie in."""
        squares = np.zeros(self.index.shape, dtype=np.bool_)
        steps = sorted({*range(-reach, reach, TILE), reach})
        rows, cols = places // ROW, places % ROW
        for down in steps:
            for across in steps:
                squares[(rows + down) >> SHIFT, (cols + across) >> SHIFT] = True
        return squares

    def touched_by(self, boxes: Sequence[Box]) -> NDArray[np.bool_]:
        """(R, C) the squares that boxes touch."""
        height, width = self.index.shape
        squares = np.zeros((height, width), dtype=np.bool_)
        for box in boxes:
            rows, cols = box.aligned(TILE).within(self.first, (TILE * height, TILE * width))
            squares[rows.start >> SHIFT : rows.stop >> SHIFT, cols.start >> SHIFT : cols.stop >> SHIFT] = True
        return squares

    def among(self, wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
        """(N, 2) the squares (R, C) that are wanted and have a tile."""
        return np.asarray(np.argwhere(wanted & (self.index >= 0)))

    def part(self, pool: NDArray[Any], box: Box) -> NDArray[Any]:
        """(H, W) what a flat array has of the cells in a box, 0 or False where there is no tile."""
        part = np.zeros((box.bottom - box.top, box.right - box.left), dtype=pool.dtype)
        _copy(self.index, pool, box.top - self.first[0], box.left - self.first[1], part)
        return part

    def has_within(self, mask: NDArray[np.bool_], cell: tuple[int, int], reach: float) -> bool:
        """Whether a flat mask is True in a cell whose centre lies within `reach` cells from that of another one."""
        return bool(_has_within(self.index, mask, cell[0] - self.first[0], cell[1] - self.first[1], reach))


@numba.njit(cache=True, error_model="numpy")
def slot(index: Index, place: int) -> int:
    """Where the cell at a place is in the flat arrays; its square must have a tile."""
    row, col = place >> 32, place & 0xFFFFFFFF
    tile = np.int64(index[row >> SHIFT, col >> SHIFT])
    return int((tile << (2 * SHIFT)) + ((row & (TILE - 1)) << SHIFT) + (col & (TILE - 1)))


@numba.njit(cache=True, error_model="numpy")
def _copy(index: Index, pool: NDArray[Any], top: int, left: int, part: NDArray[Any]) -> None:
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
                    part[row, col] = pool[begin + col]


@numba.njit(cache=True, error_model="numpy")
def _has_within(index: Index, mask: NDArray[np.bool_], row: int, col: int, reach: float) -> bool:
    """As `Tiles.has_within`, of a cell in a row and column of the index; the nearest rows are looked at first."""
    rows, cols = index.shape[0] << SHIFT, index.shape[1] << SHIFT
    for step in range(2 * int(reach) + 1):
        down = (step + 1) // 2 if step % 2 else -(step // 2)
        r, half = row + down, int(math.sqrt(reach * reach - down * down))
        if not 0 <= r < rows:
            continue
        for c in range(max(col - half, 0), min(col + half + 1, cols)):
            tile = np.int64(index[r >> SHIFT, c >> SHIFT])
            if tile >= 0 and mask[(tile << (2 * SHIFT)) + ((r & (TILE - 1)) << SHIFT) + (c & (TILE - 1))]:
                return True
    return False
