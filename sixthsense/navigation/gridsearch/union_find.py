"""Parts that are joined: a forest of numbers, in which each leads to the first one of its part (union-find)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def root_of(root: Numbers, i: int) -> int:
    """The first of the part of i; makes the way to it shorter."""
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@numba.njit(cache=True, error_model="numpy")
def join(root: Numbers, i: int, j: int) -> None:
    """Make one part of those of i and j."""
    a, b = root_of(root, i), root_of(root, j)
    root[max(a, b)] = min(a, b)
