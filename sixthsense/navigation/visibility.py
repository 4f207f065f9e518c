"""What is visible from a cell of a grid, and the nearest cell from which a cell is visible.

Masks are (H, W), indexed [row = y, col = x]; lengths are in cells.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.navigation.gridsearch import Costs
from sixthsense.slam.mapping.freespace import Bools


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
def nearest_viewpoint(cost: Costs, obstacles: Bools, row: int, col: int, reach: float) -> int:
    """The flat index of the nearest cell with finite `cost` from which a cell is visible within `reach`; -1 if none.

    Squares around the cell are searched outwards until no cell further out can be nearer.
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
                if away < best and line_of_sight(obstacles, r, c, row, col):
                    best, found = away, r * width + c
    return found


@numba.njit(cache=True, error_model="numpy")
def expected_gain(obstacles: Bools, unseen: Bools, row: int, col: int, rays: int, reach: float, depth: int) -> int:
    """How many cells of `unseen` are crossed by evenly spaced `rays` from a cell's centre, each `reach` long.

    A ray ends at an obstacle and after `depth` unseen cells: cells deep in unknown space are probably occluded.
    """
    height, width = obstacles.shape
    counted = np.zeros((height, width), dtype=np.bool_)
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
                if not counted[r, c]:
                    counted[r, c] = True
                    count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def visible_cells(obstacles: Bools, mask: Bools, row: int, col: int, reach: float) -> Bools:
    """(H, W) the cells of `mask` that are visible from a cell within `reach`."""
    height, width = mask.shape
    visible = np.zeros((height, width), dtype=np.bool_)
    span = int(reach)
    for r in range(max(row - span, 0), min(row + span + 1, height)):
        for c in range(max(col - span, 0), min(col + span + 1, width)):
            if mask[r, c] and math.hypot(r - row, c - col) <= reach:
                visible[r, c] = line_of_sight(obstacles, row, col, r, c)
    return visible


def gapless_reach(spacing_rad: float, max_range_cells: float) -> float:
    """The range, in cells, up to which beams of a spacing leave no gap as wide as a cell, with some slack.

    At most 0.95 of the laser's range.
    """
    return min(0.8 / max(spacing_rad, 1e-9), 0.95 * max_range_cells)
