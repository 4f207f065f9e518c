"""The nearest of some cells of a grid from which another cell is visible."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.gridsearch.reached import TILE
from sixthsense.navigation.visibility import line_of_sight
from sixthsense.slam.mapping.freespace import Bools

_DIRECTIONS = 1 << 24
"""that a search tells apart"""
Cell = tuple[int, int]
"""Row and column."""


class Viewpoints:
    """Searches among the allowed cells of one map for the nearest that has a cell in view."""

    def __init__(
        self,
        allowed: Bools,
        obstacles: Bools,
        reach: float,
        tiles: Bools | None = None,
        preferred: Bools | None = None,
    ) -> None:
        """`allowed` and `obstacles` are (H, W) and must not change afterwards; `reach` of a view is in cells.

        `tiles` are those that `mark_tiles` marks, where they are known. Other cells than the `preferred` ones are found
        where none of these has a view.
        """
        self._allowed, self._obstacles, self._reach = allowed, obstacles, reach
        self._preferred = preferred
        if tiles is None:
            tiles = np.zeros((-(-allowed.shape[0] // TILE), -(-allowed.shape[1] // TILE)), dtype=np.bool_)
            mark_tiles(tiles, allowed, obstacles, np.ones_like(tiles))
        self._tiles = tiles

    def nearest(self, cell: Cell) -> Cell | None:
        """The nearest allowed cell from which no obstacle hides a cell, both row and col; None if there is none."""
        index = -1
        if self._preferred is not None:
            index = _nearest(self._tiles, self._preferred, self._obstacles, *cell, self._reach)
        if index < 0:
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
    that of the smallest square, then the first. Of each only the directions are searched that no obstacle of a smaller
    square hides, so that the work is that of the visible cells.
    """
    width = allowed.shape[1]
    if allowed[row, col]:
        return int(row * width + col)
    # Of directions that are open, in their order: no more are told apart than the largest square has cells.
    ranges, count = np.empty((8 * int(reach) + 1, 2), dtype=np.int64), 1
    ranges[0, 0], ranges[0, 1] = 0, _DIRECTIONS
    hiding = np.empty((8 * int(reach) + 1, 2), dtype=np.int64)
    best, found = np.nextafter(reach, np.inf), -1
    for ring in range(1, int(reach) + 1):
        if ring > best or count == 0:
            break
        hidden, of_smaller, around = 0, found, 8 * ring
        for k in range(count):
            at, past = -(-ranges[k, 0] * around // _DIRECTIONS), -(-ranges[k, 1] * around // _DIRECTIONS)
            while at < past:
                side = at // (2 * ring)
                end = min(past, 2 * ring * (side + 1))
                is_row, fixed, moving, step = _side(row, col, ring, side, at - 2 * ring * side)
                first, left = _within(allowed.shape, is_row, fixed, moving, step, end - at)
                at, moving = end, moving + step * first
                while left > 0:
                    r, c = (fixed, moving) if is_row else (moving, fixed)
                    cells = 1
                    if not tiles[r // TILE, c // TILE]:
                        cells = TILE - moving % TILE if step > 0 else moving % TILE + 1
                    left, moving = left - cells, moving + step * cells
                    if obstacles[r, c]:
                        hiding[hidden, 0], hiding[hidden, 1] = r - row, c - col
                        hidden += 1
                    if allowed[r, c]:
                        away, index = math.hypot(r - row, c - col), r * width + c
                        first_of_equals = away == best and found != of_smaller and index < found
                        if (away < best or first_of_equals) and line_of_sight(obstacles, r, c, row, col):
                            best, found = away, index
        for k in range(hidden):
            count = _hide(ranges, count, obstacles, row, col, hiding[k, 0], hiding[k, 1])
    return found


@numba.njit(cache=True, error_model="numpy")
def _side(row: int, col: int, ring: int, side: int, along: int) -> tuple[bool, int, int, int]:
    """Whether one side of the square `ring` cells around a cell is a row, which, and where and how it goes on.

    The sides follow one another from the first corner, along the first row, down the last column, and back.
    """
    is_row, forward = side % 2 == 0, side < 2
    fixed = (row if is_row else col) + (ring if side in (1, 2) else -ring)
    moving = (col if is_row else row) + (along - ring if forward else ring - along)
    return is_row, fixed, moving, 1 if forward else -1


@numba.njit(cache=True, error_model="numpy")
def _within(shape: tuple[int, int], is_row: bool, fixed: int, moving: int, step: int, cells: int) -> tuple[int, int]:
    """The first of some cells of a row or column that lies in the grid, and how many do."""
    across, along = (shape[0], shape[1]) if is_row else (shape[1], shape[0])
    if not 0 <= fixed < across:
        return 0, 0
    first = max(-moving if step > 0 else moving - along + 1, 0)
    past = min(cells, along - moving if step > 0 else moving + 1)
    return first, past - first


@numba.njit(cache=True, error_model="numpy")
def _hide(ranges: NDArray[np.int64], count: int, obstacles: Bools, row: int, col: int, rows: int, cols: int) -> int:
    """Take what an obstacle at an offset hides from the ranges of directions; how many ranges are left.

    With each of its neighbours it hides what is between the two as well: no line of sight passes there.
    """
    centre = _direction(rows, cols)
    low, high = _extent(rows, cols, centre)
    ring, (height, width) = max(abs(rows), abs(cols)), obstacles.shape
    for r in range(max(rows - 1, -ring, -row), min(rows + 2, ring + 1, height - row)):
        for c in range(max(cols - 1, -ring, -col), min(cols + 2, ring + 1, width - col)):
            if obstacles[row + r, col + c] and max(abs(r), abs(c)) > 0:  # but not the cell itself
                low_too, high_too = _extent(r, c, centre)
                # Whole steps of direction strictly between the two.
                first = math.floor(min(low, low_too)) + 1
                past = math.floor(max(high, high_too))
                count = _without(ranges, count, max(first, 0), min(past, _DIRECTIONS))
                if first < 0:
                    count = _without(ranges, count, first + _DIRECTIONS, _DIRECTIONS)
                if past > _DIRECTIONS:
                    count = _without(ranges, count, 0, past - _DIRECTIONS)
    return count


@numba.njit(cache=True, error_model="numpy")
def _extent(rows: int, cols: int, centre: float) -> tuple[float, float]:
    """The least and the greatest direction of the corners of the cell at an offset, counted on from one near it."""
    low, high = math.inf, -math.inf
    for k in range(4):
        corner = _direction(rows + (0.5 if k < 2 else -0.5), cols + (0.5 if k % 2 else -0.5))
        if abs(corner - centre) > 0.5 * _DIRECTIONS:
            corner -= math.copysign(_DIRECTIONS, corner - centre)
        low, high = min(low, corner), max(high, corner)
    return low, high


@numba.njit(cache=True, error_model="numpy")
def _direction(rows: float, cols: float) -> float:
    """Direction of an offset as a number from 0 up to `_DIRECTIONS`: how far it lies along the square about (0, 0)."""
    ring = max(abs(rows), abs(cols))
    if -rows == ring and cols < ring:
        side, along = 0, cols
    elif cols == ring and rows < ring:
        side, along = 1, rows
    elif rows == ring and cols > -ring:
        side, along = 2, -cols
    else:
        side, along = 3, -rows
    return (2 * side + 1 + along / ring) * (_DIRECTIONS // 8)


@numba.njit(cache=True, error_model="numpy")
def _without(ranges: NDArray[np.int64], count: int, low: int, past: int) -> int:
    """Take the directions from `low` up to `past` from the ranges; how many are left."""
    if low >= past:
        return count
    k = 0
    while k < count:
        first, end = ranges[k, 0], ranges[k, 1]
        if first >= past:
            break
        if end <= low:
            k += 1
        elif first < low and end > past:
            if count == len(ranges):
                break
            for i in range(count, k + 1, -1):
                ranges[i, 0], ranges[i, 1] = ranges[i - 1, 0], ranges[i - 1, 1]
            ranges[k, 1] = low
            ranges[k + 1, 0], ranges[k + 1, 1] = past, end
            return count + 1
        elif first < low:
            ranges[k, 1] = low
            k += 1
        elif end > past:
            ranges[k, 0] = past
            break
        else:
            count -= 1
            for i in range(k, count):
                ranges[i, 0], ranges[i, 1] = ranges[i + 1, 0], ranges[i + 1, 1]
    return count
