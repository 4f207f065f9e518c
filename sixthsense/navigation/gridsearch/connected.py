"""The cells that are connected to one cell."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.freespace import Bools


@numba.njit(cache=True, error_model="numpy")
def reachable_cells(blocked: Bools, row: int, col: int) -> NDArray[np.int32]:
    """The flat indices (K,) of the cells connected to a free cell by straight steps, that cell first.

    Diagonal steps would reach no others, since they cut no corners.
    """
    height, width = blocked.shape
    visited = blocked.copy().ravel()
    cells = np.empty(np.count_nonzero(~visited), dtype=np.int32)
    cells[0] = row * width + col
    visited[cells[0]] = True
    count, i = 1, 0
    while i < count:
        cell = cells[i]
        across = cell % width
        for to, inside in (
            (cell - width, cell >= width),
            (cell + width, cell < width * (height - 1)),
            (cell - 1, across > 0),
            (cell + 1, across < width - 1),
        ):
            if inside and not visited[to]:
                visited[to] = True
                cells[count] = to
                count += 1
        i += 1
    return cells[:count].copy()
