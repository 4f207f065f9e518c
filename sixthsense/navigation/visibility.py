"""What is visible from a cell of a grid.

Masks are (H, W), indexed [row = y, col = x]; lengths are in cells.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.freespace import Bools


@numba.njit(cache=True, error_model="numpy")
def line_of_sight(obstacles: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether no cell of `obstacles` lies between the centres of two cells; the same both ways.

    The line is traversed from cell to cell across edges (Amanatides and Woo 1987). Where it passes through a corner,
    both cells beside it count, so that no ray passes a wall of cells that touch at their corners.
    """
    rows, cols = abs(to_row - row), abs(to_col - col)
    step_row, step_col = (1 if to_row > row else -1), (1 if to_col > col else -1)
    # Twice the distances to the next edges, times rows and cols: whole numbers.
    ahead_row, ahead_col = cols, rows
    left = rows + cols
    while left > 1:
        left -= 1
        if ahead_col == ahead_row and rows > 0 and cols > 0:
            if obstacles[row + step_row, col] or obstacles[row, col + step_col]:
                return False
            row, col, left = row + step_row, col + step_col, left - 1
            ahead_row, ahead_col = ahead_row + 2 * cols, ahead_col + 2 * rows
            if left == 0:
                return True
        elif rows == 0 or (cols > 0 and ahead_col < ahead_row):
            col += step_col
            ahead_col += 2 * rows
        else:
            row += step_row
            ahead_row += 2 * cols
        if obstacles[row, col]:
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def nearest_view(obstacles: Bools, places: NDArray[np.int64], side: int, row: int, col: int, reach: float) -> int:
    """The one of the `places` (R, C) that is nearest to a cell and in line of sight; -1 without one within `reach`.

    Places are flat indices of one cell in each tile of `side` cells, -1 in tiles without one. Tiles are searched in
    squares about the cell, outwards until no place further out can be nearer.
    """
    width = obstacles.shape[1]
    rows, cols = places.shape
    tile_row, tile_col = row // side, col // side
    best, found = reach, -1
    for ring in range(int(reach / side) + 2):
        if (ring - 1) * side > best:
            break
        for r in range(max(tile_row - ring, 0), min(tile_row + ring + 1, rows)):
            is_whole_row = abs(r - tile_row) == ring
            for c in range(tile_col - ring, tile_col + ring + 1, 1 if is_whole_row or ring == 0 else 2 * ring):
                if not 0 <= c < cols or places[r, c] < 0:
                    continue
                from_row, from_col = places[r, c] // width, places[r, c] % width
                away = math.hypot(from_row - row, from_col - col)
                if away < best and line_of_sight(obstacles, from_row, from_col, row, col):
                    best, found = away, places[r, c]
    return found


@numba.njit(cache=True, error_model="numpy")
def visible_cells(obstacles: Bools, mask: Bools, row: int, col: int, reach: float) -> NDArray[np.int64]:
    """(N, 2) the cells of `mask` (H, W) that are visible from a cell within `reach`, row by row."""
    span, count = int(reach), 0
    rows = range(max(row - span, 0), min(row + span + 1, mask.shape[0]))
    cols = range(max(col - span, 0), min(col + span + 1, mask.shape[1]))
    found = np.empty((len(rows) * len(cols), 2), dtype=np.int64)
    for r in rows:
        for c in cols:
            if mask[r, c] and math.hypot(r - row, c - col) <= reach and line_of_sight(obstacles, row, col, r, c):
                found[count, 0], found[count, 1] = r, c
                count += 1
    return found[:count]
