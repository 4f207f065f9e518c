"""What is visible from a cell of a grid, and the nearest cell from which a cell is visible.

Masks are (H, W), indexed [row = y, col = x]; lengths are in cells.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.slam.mapping.freespace import Bools

_DIRECTIONS = 8192
"""in which a search for viewpoints tells shadows apart"""
_NEAR = 16.0
"""cells within which most viewpoints are found"""
_REACHABLE, _OBSTACLE = np.uint8(1), np.uint8(2)


@numba.njit(cache=True, error_model="numpy")
def line_of_sight(obstacles: Bools, row: int, col: int, to_row: int, to_col: int) -> bool:
    """Whether no cell of `obstacles` lies between the centres of two cells.

    The line is traversed from cell to cell across edges (Amanatides and Woo 1987), so that no ray passes a wall of
    cells that touch at their corners.
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
def nearest_viewpoint(reachable: Bools, obstacles: Bools, row: int, col: int, reach: float) -> int:
    """The flat index of the nearest `reachable` cell from which a cell is visible within `reach`; -1 if none.

    Squares around the cell are searched outwards until no cell further out can be nearer. Cells in the shadow of an
    obstacle of a smaller square are left out.
    """
    found = _nearest_viewpoint(reachable, obstacles, row, col, min(reach, _NEAR))
    return found if found >= 0 or reach <= _NEAR else _nearest_viewpoint(reachable, obstacles, row, col, reach)


@numba.njit(cache=True, error_model="numpy")
def _nearest_viewpoint(reachable: Bools, obstacles: Bools, row: int, col: int, reach: float) -> int:
    span, width = int(reach), reachable.shape[1]
    # A copy of the surroundings, since a square crosses a row at every step.
    top, left = max(row - span, 0), max(col - span, 0)
    kinds = np.zeros((2 * span + 1, 2 * span + 1), dtype=np.uint8)
    for r in range(top, min(row + span + 1, reachable.shape[0])):
        for c in range(left, min(col + span + 1, width)):
            kinds[r - row + span, c - col + span] = reachable[r, c] * _REACHABLE + obstacles[r, c] * _OBSTACLE
    shadow = np.zeros(_DIRECTIONS, dtype=np.bool_)
    hiding = np.empty((8 * span + 1, 2), dtype=np.int64)
    best, found = reach + 1e-9, -1
    for ring in range(span + 1):
        if ring > best:
            break
        count = 0
        for r in range(-ring, ring + 1):
            for c in range(-ring, ring + 1, 1 if abs(r) == ring else 2 * ring):
                kind = kinds[r + span, c + span]
                if kind & _OBSTACLE and ring > 0:
                    hiding[count] = r, c
                    count += 1
                if kind & _REACHABLE and not shadow[int(_direction(r, c))]:
                    away = math.hypot(r, c)
                    if away < best and line_of_sight(obstacles, row + r, col + c, row, col):
                        best, found = away, (row + r) * width + col + c
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


@numba.njit(cache=True, error_model="numpy")
def expected_gain(obstacles: Bools, unseen: Bools, row: int, col: int, rays: int, reach: float, depth: int) -> int:
    """How many cells of `unseen` are crossed by evenly spaced `rays` from a cell's centre, each `reach` long.

    A ray ends at an obstacle and after `depth` unseen cells: cells deep in unknown space are probably occluded.
    """
    height, width = obstacles.shape
    span = int(reach) + 2
    counted = np.zeros((2 * span + 1, 2 * span + 1), dtype=np.bool_)  # the surroundings of the cell
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
                if not counted[r - row + span, c - col + span]:
                    counted[r - row + span, c - col + span] = True
                    count += 1
    return count


def visible_cells(obstacles: Bools, mask: Bools, row: int, col: int, reach: float) -> Bools:
    """(H, W) the cells of `mask` that are visible from a cell within `reach`."""
    visible = np.zeros(mask.shape, dtype=np.bool_)
    mark_visible(visible, obstacles, mask, row, col, reach)
    return visible


@numba.njit(cache=True, error_model="numpy")
def mark_visible(visible: Bools, obstacles: Bools, mask: Bools, row: int, col: int, reach: float) -> None:
    """Add to `visible` (H, W) the cells of `mask` that are visible from a cell within `reach`."""
    height, width = mask.shape
    span = int(reach)
    for r in range(max(row - span, 0), min(row + span + 1, height)):
        for c in range(max(col - span, 0), min(col + span + 1, width)):
            if mask[r, c] and not visible[r, c] and math.hypot(r - row, c - col) <= reach:
                visible[r, c] = line_of_sight(obstacles, row, col, r, c)


def gapless_reach(spacing_rad: float, max_range_cells: float) -> float:
    """The range, in cells, up to which beams of a spacing leave no gap as wide as a cell, with some slack.

    At most 0.95 of the laser's range.
    """
    return min(0.8 / max(spacing_rad, 1e-9), 0.95 * max_range_cells)
