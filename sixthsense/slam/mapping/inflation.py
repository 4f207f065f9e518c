"""Inflation of obstacles by a disc, and where a wider one gives way to a narrower."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import TOUCH

MAX_INFLATION = 1000
"""Cells; a larger disc takes longer to draw than a robot takes to drive."""


def check_inflation(cells: float) -> None:
    """Raise InputError for an inflation of more than `MAX_INFLATION` cells."""
    if cells > MAX_INFLATION:
        raise InputError("grid", f"found an inflation of {cells:.0f} cells", f"at most {MAX_INFLATION}")


def disc(radius: float) -> NDArray[np.int64]:
    """(K, 2) offsets (row, col) of the cells about whose centres a disc, in cells, touches the square at (0, 0)."""
    reach = math.floor(radius + 0.5 + TOUCH)
    offsets = np.arange(-reach, reach + 1)
    gap = np.maximum(np.abs(offsets) - 0.5, 0.0)
    return np.argwhere(np.hypot(gap[:, None], gap[None, :]) <= radius + TOUCH) - reach


def disc_cells(centres: Array, radius_m: float, cell_m: float) -> NDArray[np.int64]:
    """(K, 2) cells, row, col from the world's origin, of discs about centres (N, 2), metres; none of them twice."""
    at = np.floor(centres / cell_m).astype(np.int64)[:, ::-1]
    return np.unique((at[:, None] + disc(radius_m / cell_m)[None]).reshape(-1, 2), axis=0)
