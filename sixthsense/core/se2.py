"""Rigid motions of the plane, SE(2): poses as triples, rows of poses, and covariances in their axes.

A pose `T_a_b` is x, y (m) and theta (rad, in [-pi, pi)) of frame b seen from frame a. Kernels take it as a triple,
arrays have one in each row; `Pose` is the same for users, and computes by these functions.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


@numba.njit(cache=True, error_model="numpy")
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi); an angle in that interval is returned bit for bit."""
    if -math.pi <= angle < math.pi:
        return angle
    inside = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # The modulo of a tiny negative number rounds up to 2 pi itself.
    return -math.pi if inside >= math.pi else inside


@numba.njit(cache=True, error_model="numpy")
def composed(a: Triple, b: Triple) -> Triple:
    """`T_a_c` of `T_a_b` and `T_b_c`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrapped(a[2] + b[2])


@numba.njit(cache=True, error_model="numpy")
def inverted(a: Triple) -> Triple:
    """`T_b_a` of `T_a_b`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return -c * a[0] - s * a[1], s * a[0] - c * a[1], wrapped(-a[2])


@numba.njit(cache=True, error_model="numpy")
def relative(a: Triple, b: Triple) -> Triple:
    """`T_a_b` of `T_w_a` and `T_w_b`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, c * dy - s * dx, wrapped(b[2] - a[2])


def compose(a: Array, b: Array) -> Array:
    """`T_a_c` of `T_a_b` and `T_b_c`, (3,) or (N, 3) each; (3,) if both are."""
    return _by_rows(_composed_rows, a, b)


def between(a: Array, b: Array) -> Array:
    """`T_a_b` of `T_w_a` and `T_w_b`, (3,) or (N, 3) each; (3,) if both are."""
    return _by_rows(_relative_rows, a, b)


@numba.njit(cache=True, error_model="numpy")
def inverse(pose: Array) -> Array:
    """(3,) `T_b_a` of `T_a_b` (3,)."""
    x, y, theta = inverted((pose[0], pose[1], pose[2]))
    return np.array([x, y, theta])


def move_points(poses: Array, points: Array) -> Array:
    """(n, k, 2) points in frame a, of those in frames b at `T_a_b` (n, 3), or (1, 3) for all."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], axis=-1)


def _by_rows(kernel: numba.core.dispatcher.Dispatcher, a: Array, b: Array) -> Array:
    # Contiguous, so that there is one compiled form.
    a, b = np.ascontiguousarray(a, dtype=np.float64), np.ascontiguousarray(b, dtype=np.float64)
    found = kernel(a.reshape(-1, 3), b.reshape(-1, 3))
    return np.asarray(found[0] if a.ndim == b.ndim == 1 else found)


@numba.njit(cache=True, error_model="numpy")
def _composed_rows(a: Array, b: Array) -> Array:
    """(N, 3) of rows (N, 3); a single row stands for all."""
    n = len(b) if len(a) == 1 else len(a)
    out = np.empty((n, 3))
    for k in range(n):
        i, j = k if len(a) > 1 else 0, k if len(b) > 1 else 0
        first, second = (a[i, 0], a[i, 1], a[i, 2]), (b[j, 0], b[j, 1], b[j, 2])
        out[k, 0], out[k, 1], out[k, 2] = composed(first, second)
    return out


@numba.njit(cache=True, error_model="numpy")
def _relative_rows(a: Array, b: Array) -> Array:
    """(N, 3) of rows (N, 3); a single row stands for all."""
    n = len(b) if len(a) == 1 else len(a)
    out = np.empty((n, 3))
    for k in range(n):
        i, j = k if len(a) > 1 else 0, k if len(b) > 1 else 0
        first, second = (a[i, 0], a[i, 1], a[i, 2]), (b[j, 0], b[j, 1], b[j, 2])
        out[k, 0], out[k, 1], out[k, 2] = relative(first, second)
    return out


@numba.njit(cache=True, error_model="numpy")
def transformed_covariance(cov: Array, c: float, s: float, u: float, v: float) -> Array:
    """`J @ cov @ J.T` (3, 3) for the Jacobian J of a motion of the plane, [[c, -s, u], [s, c, v], [0, 0, 1]].

    J is the adjoint of a pose with heading atan2(s, c) at (-v, u) (Sola, Deray and Atchuthan, "A micro Lie theory",
    arXiv 1812.01537, appendix C). Written out: for matrices of this size a call of BLAS takes longer than the product.
    """
    left, out = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        left[0, k] = c * cov[0, k] - s * cov[1, k] + u * cov[2, k]
        left[1, k] = s * cov[0, k] + c * cov[1, k] + v * cov[2, k]
        left[2, k] = cov[2, k]
    for k in range(3):
        out[k, 0] = c * left[k, 0] - s * left[k, 1] + u * left[k, 2]
        out[k, 1] = s * left[k, 0] + c * left[k, 1] + v * left[k, 2]
        out[k, 2] = left[k, 2]
    return out


@numba.njit(cache=True, error_model="numpy")
def composed_covariance(first: Array, later: Array, heading: float, x: float, y: float) -> Array:
    """(3, 3) of a motion by (x, y) at a heading, of covariance `later`, after one of covariance `first`."""
    c, s = math.cos(heading), math.sin(heading)
    moved = transformed_covariance(first, 1.0, 0.0, -s * x - c * y, c * x - s * y)
    return moved + transformed_covariance(later, c, s, 0.0, 0.0)


@numba.njit(cache=True, error_model="numpy")
def turned_covariance(cov: Array, angle: float) -> Array:
    """(3, 3) symmetric: a covariance in axes turned by an angle."""
    turned = transformed_covariance(cov, math.cos(angle), math.sin(angle), 0.0, 0.0)
    return 0.5 * (turned + turned.T)
