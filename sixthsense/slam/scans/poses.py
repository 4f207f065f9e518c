"""Arrays of poses (x, y, theta), one per row; m and rad."""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.pose_kernels import wrapped


def compose(a: Array, b: Array) -> Array:
    """`T_a_c` of `T_a_b` and `T_b_c`, (3,) or (N, 3) each; (3,) if both are."""
    return _by_rows(_composed, a, b)


def between(a: Array, b: Array) -> Array:
    """`T_a_b` of `T_w_a` and `T_w_b`, (3,) or (N, 3) each; (3,) if both are."""
    return _by_rows(_between, a, b)


def _by_rows(kernel: numba.core.dispatcher.Dispatcher, a: Array, b: Array) -> Array:
    # Contiguous, so that there is one compiled form.
    a, b = np.ascontiguousarray(a, dtype=np.float64), np.ascontiguousarray(b, dtype=np.float64)
    found = kernel(a.reshape(-1, 3), b.reshape(-1, 3))
    return np.asarray(found[0] if a.ndim == b.ndim == 1 else found)


@numba.njit(cache=True, error_model="numpy")
def _composed(a: Array, b: Array) -> Array:
    """(N, 3) of rows (N, 3); a single row stands for all."""
    n = len(b) if len(a) == 1 else len(a)
    out = np.empty((n, 3))
    for k in range(n):
        i, j = k if len(a) > 1 else 0, k if len(b) > 1 else 0
        c, s = math.cos(a[i, 2]), math.sin(a[i, 2])
        out[k, 0] = a[i, 0] + c * b[j, 0] - s * b[j, 1]
        out[k, 1] = a[i, 1] + s * b[j, 0] + c * b[j, 1]
        out[k, 2] = wrapped(a[i, 2] + b[j, 2])
    return out


@numba.njit(cache=True, error_model="numpy")
def _between(a: Array, b: Array) -> Array:
    """(N, 3) of rows (N, 3); a single row stands for all."""
    n = len(b) if len(a) == 1 else len(a)
    out = np.empty((n, 3))
    for k in range(n):
        i, j = k if len(a) > 1 else 0, k if len(b) > 1 else 0
        c, s = math.cos(a[i, 2]), math.sin(a[i, 2])
        dx, dy = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1]
        out[k, 0], out[k, 1] = c * dx + s * dy, c * dy - s * dx
        out[k, 2] = wrapped(b[j, 2] - a[i, 2])
    return out
