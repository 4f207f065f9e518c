"""Symmetric matrices as their lower triangle in a column-major array."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array


@numba.njit(cache=True, error_model="numpy")
def selected(upper: Array, index: NDArray[np.int64]) -> Array:
    """(k, k) the rows and columns at `index` (k,), which ascends, of a matrix (n, n) whose transpose is `upper`.

    The result is a transpose, too. What lies below the diagonal of a transpose is undefined.
    """
    k = len(index)
    out = np.empty((k, k))
    for j in range(k):
        row = upper[index[j]]
        for i in range(j, k):
            out[j, i] = row[index[i]]
    return out


@numba.njit(cache=True, error_model="numpy")
def columns(upper: Array, index: NDArray[np.int64]) -> Array:
    """(k, n) the columns at `index` (k,), one a row, of a symmetric matrix (n, n) whose transpose is `upper`."""
    k, n = len(index), len(upper)
    out = np.empty((k, n))
    for j in range(k):
        i = index[j]
        out[j, i:] = upper[i, i:]
        for other in range(i):
            out[j, other] = upper[other, i]
    return out
