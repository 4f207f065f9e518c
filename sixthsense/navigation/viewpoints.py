"""The nearest of some cells of a grid from which another cell is visible."""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.navigation.gridsearch.reached import TILE
from sixthsense.navigation.visibility import line_of_sight
from sixthsense.slam.mapping.freespace import Bools

_DIRECTIONS = 8192
"""in which a search tells shadows apart"""
Cell = tuple[int, int]
"""Row and column."""


class Viewpoints:
    """Searches among the allowed cells of one map for the nearest that has a cell in view."""

    def __init__(self, allowed: Bools, obstacles: Bools, reach: float, tiles: Bools | None = None) -> None:
        """`allowed` and `obstacles` are (H, W) and must not change afterwards; `reach` of a view is in cells.

        `tiles` are those that `mark_tiles` marks, where they are known.
        """
        self._allowed, self._obstacles, self._reach = allowed, obstacles, reach
        if tiles is None:
            tiles = np.zeros((-(-allowed.shape[0] // TILE), -(-allowed.shape[1] // TILE)), dtype=np.bool_)
            mark_tiles(tiles, allowed, obstacles, np.ones_like(tiles))
        self._tiles = tiles

    def nearest(self, cell: Cell) -> Cell | None:
        """The nearest allowed cell from which no obstacle hides a cell, both row and col; None if there is none."""
        index = _nearest(self._tiles, self._allowed, self._obstacles, *cell, self._reach)
        return divmod(int(index), self._obstacles.shape[1]) if index >= 0 else None


@numba.njit(cache=True, error_model="numpy")
def mark_tiles(tiles: Bools, allowed: Bools, obstacles: Bools, changed: Bools) -> None:
    """Mark those of the `changed` tiles (R, C), of `TILE` cells, that hold an allowed cell or an obstacle."""
    height, width = allowed.shape
    for r in range(tiles.shape[0]):
        for c in range(tiles.shape[1]):
            if not changed[r, c]:
                continue
            tiles[r, c] = False
            for row in range(r * TILE, min((r + 1) * TILE, height)):
                for col in range(c * TILE, min((c + 1) * TILE, width)):
                    if allowed[row, col] or obstacles[row, col]:
                        tiles[r, c] = True


@numba.njit(cache=True, error_model="numpy")
def _nearest(tiles: Bools, allowed: Bools, obstacles: Bools, row: int, col: int, reach: float) -> int:
    """The flat index of the nearest allowed cell from which a cell is visible within `reach`; -1 if none.

    Squares around the cell are searched outwards until no cell further out can be nearer; of several that are as near,
    that of the smallest square, then the first. Cells in the shadow of an obstacle of a smaller square are left out.
    """
    height, width = allowed.shape
    shadow = np.zeros(_DIRECTIONS, dtype=np.bool_)
    hiding = np.empty((8 * int(reach) + 1, 2), dtype=np.int64)
    best, found = reach + 1e-9, -1
    for ring in range(int(reach) + 1):
        if ring > best:
            break
        count, of_smaller = 0, found
        for side in range(4 if ring > 0 else 1):
            # Rows above and below, then the columns between them.
            is_row = side < 2
            at = (row if is_row else col) + (ring if side % 2 else -ring)
            if not 0 <= at < (height if is_row else width):
                continue
            along = max(col - ring, 0) if is_row else max(row - ring + 1, 0)
            past = min(col + ring + 1, width) if is_row else min(row + ring, height)
            while along < past:
                r, c = (at, along) if is_row else (along, at)
                if not tiles[r // TILE, c // TILE]:
                    along = (along // TILE + 1) * TILE
                    continue
                along += 1
                if not (allowed[r, c] or obstacles[r, c]) or shadow[int(_direction(r - row, c - col))]:
                    continue
                if obstacles[r, c] and ring > 0:
                    hiding[count] = r - row, c - col
                    count += 1
                if allowed[r, c]:
                    away, index = math.hypot(r - row, c - col), r * width + c
                    first_of_equals = away == best and found != of_smaller and index < found
                    if (away < best or first_of_equals) and line_of_sight(obstacles, r, c, row, col):
                        best, found = away, index
        for k in range(count):
            _cast_shadow(shadow, hiding[k, 0], hiding[k, 1])
    return found


@numba.njit(cache=True, error_model="numpy")
def _direction(rows: float, cols: float) -> float:
    """Direction of an offset as a number from 0 up to `_DIRECTIONS`, which ascends with the angle."""
    length = abs(rows) + abs(cols)
    if length == 0.0:
        return 0.0
    turn = rows / length if cols >= 0.0 else 2.0 - rows / length  # -1 to 3
    return min((turn + 1.0) * (_DIRECTIONS / 4.0), _DIRECTIONS - 1e-9)


@numba.njit(cache=True, error_model="numpy")
def _cast_shadow(shadow: Bools, rows: int, cols: int) -> None:
    """Mark the directions in which the cell at an offset, not that of the viewer, hides all cells behind it.

    Only whole steps of direction strictly between its corners count. The cell across the first direction hides none.
    """
    if cols == 0 and rows < 0:
        return
    low, high = float(_DIRECTIONS), 0.0
    for k in range(4):
        corner = _direction(rows + (0.5 if k < 2 else -0.5), cols + (0.5 if k % 2 else -0.5))
        low, high = min(low, corner), max(high, corner)
    for k in range(int(low) + 1, int(high)):
        shadow[k] = True
