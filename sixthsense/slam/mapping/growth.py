"""The box of a grid, which grows as the robot sees more."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import MAX_CELLS, cell_box

MIN_GROWTH = 64
"""The box grows by at least this many cells on a side."""
MAX_BOX = 1_000_000_000
"""Cells of the largest box; more come from a wrong pose or range, or from too small a cell."""


def grown_box(box: Box, low: Array, high: Array) -> Box:
    """The box extended to hold the cells from (2,) `low` up to `high`, exclusive; InputError if that is too large."""
    old_low, old_high = np.full(2, np.inf), np.full(2, -np.inf)
    if box.bottom > box.top:
        old_low, old_high = (np.array(corner, dtype=np.float64) for corner in (box[:2], box[2:]))
    if (low >= old_low).all() and (high <= old_high).all():
        return box
    # A side that must move moves by at least a quarter of the extent, so that masks are seldom drawn anew.
    all_low, all_high = np.minimum(low, old_low), np.maximum(high, old_high)
    step = np.maximum(MIN_GROWTH, (all_high - all_low) // 4)
    roomy_low = np.where(low < old_low, low - step, old_low)
    roomy_high = np.where(high > old_high, high + step, old_high)
    if np.prod(roomy_high - roomy_low) <= MAX_CELLS:
        all_low, all_high = roomy_low, roomy_high
    (row, col), (height, width) = cell_box(all_low, all_high, MAX_BOX)
    return Box(row, col, row + height, col + width)
