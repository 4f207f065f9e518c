"""Arrays of poses (x, y, theta), one per row; m and rad."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle


def compose(a: Array, b: Array) -> Array:
    """`T_a_c` (..., 3) of `T_a_b` and `T_b_c`, (3,) or (N, 3) each."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap_angle(np.asarray(a[..., 2] + b[..., 2]))], axis=-1)


def between(a: Array, b: Array) -> Array:
    """`T_a_b` (..., 3) of `T_w_a` and `T_w_b`, (3,) or (N, 3) each."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx, wrap_angle(np.asarray(b[..., 2] - a[..., 2]))], axis=-1)
