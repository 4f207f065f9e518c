"""Rigid motions of the plane, SE(2), and covariances in their axes.

A pose `T_a_b` is x, y (m) and theta (rad, in [-pi, pi)) of frame b seen from frame a. Users have a `Pose`, arrays one
pose in each row, and kernels a triple. `compose`, `inverse` and `between` compute with rows and triples alike.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numba
import numba.extending
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
"""a `Pose` to a kernel"""
Poses = TypeVar("Poses", Array, Triple)
"""a triple, or poses in rows"""


@numba.njit(cache=True, error_model="numpy")
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi); an angle in that interval is returned bit for bit."""
    if -math.pi <= angle < math.pi:
        return angle
    inside = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # The modulo of a tiny negative number rounds up to 2 pi itself.
    return -math.pi if inside >= math.pi else inside


@numba.njit(cache=True, error_model="numpy")
def triple(row: Array) -> Triple:
    """The pose in a row (3,)."""
    return row[0], row[1], row[2]


@numba.njit(cache=True, error_model="numpy")
def _compose(a: Triple, b: Triple) -> Triple:
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrapped(a[2] + b[2])


@numba.njit(cache=True, error_model="numpy")
def _inverse(a: Triple) -> Triple:
    c, s = math.cos(a[2]), math.sin(a[2])
    return -c * a[0] - s * a[1], s * a[0] - c * a[1], wrapped(-a[2])


@numba.njit(cache=True, error_model="numpy")
def _between(a: Triple, b: Triple) -> Triple:
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, c * dy - s * dx, wrapped(b[2] - a[2])


def compose(a: Poses, b: Poses) -> Poses:
    """`T_a_c` of `T_a_b` and `T_b_c`: triples, or rows (3,) or (N, 3), of which a single one stands for all."""
    return _by_rows(a, b, False) if isinstance(a, np.ndarray) else _compose(a, b)


def between(a: Poses, b: Poses) -> Poses:
    """`T_a_b` of `T_w_a` and `T_w_b`: triples, or rows (3,) or (N, 3), of which a single one stands for all."""
    return _by_rows(a, b, True) if isinstance(a, np.ndarray) else _between(a, b)


def inverse(a: Poses) -> Poses:
    """`T_b_a` of `T_a_b`: a triple, or rows (3,) or (N, 3)."""
    return between(a, np.zeros(3)) if isinstance(a, np.ndarray) else _inverse(a)


# What the three are within kernels, where poses are triples.
numba.extending.overload(compose)(lambda a, b: lambda a, b: _compose(a, b))
numba.extending.overload(between)(lambda a, b: lambda a, b: _between(a, b))
numba.extending.overload(inverse)(lambda a: lambda a: _inverse(a))


def _by_rows(a: Array, b: Array, is_between: bool) -> Array:
    # Contiguous, so that there is one compiled form.
    a, b = np.ascontiguousarray(a, dtype=np.float64), np.ascontiguousarray(b, dtype=np.float64)
    found = _rows(a.reshape(-1, 3), b.reshape(-1, 3), is_between)
    return np.asarray(found[0] if a.ndim == b.ndim == 1 else found)


@numba.njit(cache=True, error_model="numpy")
def _rows(a: Array, b: Array, is_between: bool) -> Array:
    """(N, 3) composed, or relative, of rows (N, 3); a single row stands for all."""
    n = len(b) if len(a) == 1 else len(a)
    out = np.empty((n, 3))
    for k in range(n):
        i, j = k if len(a) > 1 else 0, k if len(b) > 1 else 0
        first, second = triple(a[i]), triple(b[j])
        out[k, 0], out[k, 1], out[k, 2] = _between(first, second) if is_between else _compose(first, second)
    return out


@numba.njit(cache=True, error_model="numpy")
def conjugate(T_a_b: Triple, motion: Triple) -> Triple:
    """The motion of a frame a to which b is fixed at `T_a_b`, by the motion of b: `T_a_b @ motion @ T_b_a`."""
    return _compose(_compose(T_a_b, motion), _inverse(T_a_b))


# Written out: an expression of arrays, or an array that is assigned to a part of another one, takes Numba a second or
# two to compile, and a call of BLAS or LAPACK takes ten times as long as the numbers of matrices of this size.


@numba.njit(cache=True, error_model="numpy")
def added(a: Array, b: Array) -> Array:
    """(3, 3) sum of matrices."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, j] + b[i, j]
    return out


@numba.njit(cache=True, error_model="numpy")
def product(matrix: Array, vector: Array) -> Array:
    """(3,) of a matrix (3, 3) and a vector (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]
    return out


@numba.njit(cache=True, error_model="numpy")
def move_covariance(T_a_b: Triple, cov: Array) -> Array:
    """(3, 3) of a small motion (x, y, theta) in the axes of frame a, by its covariance (3, 3) in those of frame b.

    `Ad cov Ad^T` with the adjoint Ad of `T_a_b` (Sola, Deray and Atchuthan, "A micro Lie theory", arXiv 1812.01537,
    appendix C). The covariance of a motion is that of its error in the axes of the frame in which it ends. So:

    - the motion of a frame a, to which b is fixed, has the covariance of the motion of b moved by `T_a_b`;
    - a motion that is followed by m has its covariance moved by the inverse of m;
    - the inverse of m has the covariance of m moved by m.

    A pose without translation turns axes.
    """
    c, s, u, v = math.cos(T_a_b[2]), math.sin(T_a_b[2]), T_a_b[1], -T_a_b[0]
    left, out = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        left[0, k] = c * cov[0, k] - s * cov[1, k] + u * cov[2, k]
        left[1, k] = s * cov[0, k] + c * cov[1, k] + v * cov[2, k]
        left[2, k] = cov[2, k]
    out[0, 0] = c * left[0, 0] - s * left[0, 1] + u * left[0, 2]
    out[1, 1] = s * left[1, 0] + c * left[1, 1] + v * left[1, 2]
    out[2, 2] = left[2, 2]
    out[0, 1] = out[1, 0] = s * left[0, 0] + c * left[0, 1] + v * left[0, 2]
    out[0, 2] = out[2, 0] = left[0, 2]
    out[1, 2] = out[2, 1] = left[1, 2]
    return out


@numba.njit(cache=True, error_model="numpy")
def whitening(cov: Array) -> Array:
    """(3, 3) lower triangular W of a covariance (3, 3), with W^T W = cov^-1: it whitens errors.

    It is the inverse of the Cholesky factor: where one direction is known to millimetres and another not at all,
    rounding makes the inverse of the covariance itself indefinite. Raises ValueError for one that is not positive
    definite.
    """
    out = np.zeros((3, 3))
    first = cov[0, 0]
    a = math.sqrt(max(first, 0.0))
    d, f = cov[1, 0] / a, cov[2, 0] / a
    second = cov[1, 1] - d * d
    b = math.sqrt(max(second, 0.0))
    e = (cov[2, 1] - f * d) / b
    third = cov[2, 2] - f * f - e * e
    if not (first > 0.0 and second > 0.0 and third > 0.0):
        raise ValueError("covariance: found one that is not positive definite")
    c = math.sqrt(third)
    out[0, 0], out[1, 1], out[2, 2] = 1.0 / a, 1.0 / b, 1.0 / c
    out[1, 0] = -d / (a * b)
    out[2, 1] = -e / (b * c)
    out[2, 0] = (d * e / b - f) / (a * c)
    return out


@numba.njit(cache=True, error_model="numpy")
def inverse_covariance(cov: Array) -> Array:
    """(3, 3) inverse of a covariance, or of an information, positive definite; ValueError for any other."""
    w, out = whitening(cov), np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for k in range(j, 3):
                total += w[k, i] * w[k, j]
            out[i, j] = out[j, i] = total
    return out
