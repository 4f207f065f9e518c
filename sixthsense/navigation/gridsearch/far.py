"""The cells that are far from all marked ones."""

from __future__ import annotations

import numba
import numpy as np

from sixthsense.slam.mapping.freespace import Bools


@numba.njit(cache=True, error_model="numpy")
def far_from(marked: Bools, reach: int) -> Bools:
    """(H, W) the cells more than `reach` rows or columns away from every marked cell."""
    height, width = marked.shape
    far = np.ones((height, width), dtype=np.bool_)
    until = np.full(width, -1)  # the last row that a marked cell of each column reaches
    for row in range(height + reach):
        if row < height:
            for col in range(width):
                if marked[row, col]:
                    until[col] = row + reach
        # The row `reach` before this one has met all marked cells that reach it.
        target = row - reach
        if target < 0:
            continue
        last = -1  # the last column that a marked cell reaches in the target's row
        for col in range(width + reach):
            if col < width and until[col] >= target:
                last = col + reach
            if col >= reach and last >= col - reach:
                far[target, col - reach] = False
    return far
