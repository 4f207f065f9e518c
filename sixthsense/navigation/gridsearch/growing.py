"""Arrays of cells that grow, in kernels."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, error_model="numpy")
def appended(cells: NDArray[np.signedinteger[Any]], count: int, cell: int) -> tuple[Any, int]:
    """Append `cell` to the first `count` of `cells`, in an array twice as long if that one is full; array and count."""
    if count == len(cells):
        cells = np.concatenate((cells, np.empty_like(cells)))
    cells[count] = cell
    return cells, count + 1
