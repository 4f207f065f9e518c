"""Sorting within kernels: one short merge sort, where Numba compiles NumPy's for seconds."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, error_model="numpy")
def ascending(values: NDArray[Any]) -> NDArray[np.int64]:
    """(n,) the indices that put values (n,) in ascending order; equal ones stay in theirs, and NaN is not allowed.

    A merge sort from runs of one on: what `numpy.argsort(values, kind="stable")` gives.
    """
    n, width = len(values), 1
    order, merged = np.arange(n), np.arange(n)
    while width < n:
        for begin in range(0, n, 2 * width):
            middle, end = min(begin + width, n), min(begin + 2 * width, n)
            a, b = begin, middle
            for k in range(begin, end):
                if b == end or (a < middle and values[order[a]] <= values[order[b]]):
                    merged[k], a = order[a], a + 1
                else:
                    merged[k], b = order[b], b + 1
        order, merged = merged, order
        width *= 2
    return order
