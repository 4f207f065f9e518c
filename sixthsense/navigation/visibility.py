"""What is visible from a cell of a grid.

Masks are (H, W), indexed [row = y, col = x]; lengths are in cells.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.slam.mapping.freespace import Bools, ahead, ray_from


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
def expected_gain(
    obstacles: Bools,
    unseen: Bools,
    row: int,
    col: int,
    rays: tuple[int, int],
    reach: float,
    depth: int,
    enough: float = math.inf,
) -> int:
    """How many cells of `unseen` are crossed by evenly spaced rays from a cell's centre, each `reach` long.

    A ray ends at an obstacle and after `depth` unseen cells: cells deep in unknown space are probably occluded. `rays`
    are their number and the first one; those beside it follow, until more than `enough` cells are counted.
    """
    height, width = obstacles.shape
    number, first = rays
    span = int(reach) + 2
    counted = np.zeros((2 * span + 1, 2 * span + 1), dtype=np.bool_)  # the surroundings of the cell
    count = 0
    for i in range(number):
        angle = 2.0 * math.pi * ((first + ((i + 1) // 2 if i % 2 else -(i // 2))) % number) / number
        ray = ray_from(col + 0.5, row + 0.5, math.cos(angle), math.sin(angle))
        left = depth
        while left > 0:
            ray = ahead(ray)
            r, c = ray.row, ray.col
            if ray.gone > reach or not (0 <= r < height and 0 <= c < width) or obstacles[r, c]:
                break
            if unseen[r, c]:
                left -= 1
                if not counted[r - row + span, c - col + span]:
                    counted[r - row + span, c - col + span] = True
                    count += 1
                    if count > enough:
                        return count
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
