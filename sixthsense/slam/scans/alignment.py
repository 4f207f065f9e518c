"""Point-to-line alignment of two scans: normal equations, one way and both ways, and their solution.

A point of the source scan, seen from the target's laser, falls into a cell of bearings; the nearest return in the cells
around is its partner, and the residual is its distance from the partner's line. Partners' normals must agree, so that
the two faces of a thin wall are never confused (Censi, "An ICP variant using a point-to-line metric", ICRA 2008;
Blais and Levine, "Registering multiview range data to create 3D computer objects", PAMI 17(8), 1995).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.bearings import cell_of, direction
from sixthsense.slam.scans.scan_store import Returns

_MAX_REACH_RAD = 0.21  # to either side that a partner is searched in
NORMALS_AGREE = 0.7  # least cosine between the normals of partners
_SPARSE_CELLS = 6  # where beams are far apart, the partner may be this many beam spacings away
_MIN_DISTANCE_M = 0.3

_NEAR_M, _NEAR_RAD = 0.02, 0.005  # a smaller step says that the wide gates have done their work

HESSIAN, GRADIENT, WEIGHT, HITS, SQUARES, SPREAD, SUMS = 0, 6, 9, 10, 11, 12, 18
"""Places in the sums: upper triangle of the Hessian (6), gradient (3), sum of weights, number of partners, weighted sum
of squared residuals, and the part of the Hessian that the noise of the normals feigns (6)."""


class Loss(NamedTuple):
    """How residuals count."""

    gate_m: float
    """largest distance of partners"""
    scale_m: float
    """of the Cauchy loss"""


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def partner(returns: Returns, target: int, x: float, y: float, gate_m: float) -> int:
    """The cell of the target's return that is nearest to a point in the target's frame; -1 for none within the gate."""
    points, bearings = returns.points, returns.bearings
    distance = max(math.sqrt(x * x + y * y), _MIN_DISTANCE_M)
    centre = math.floor(cell_of(bearings, direction(x, y)) + 0.5)
    reach = int(min(gate_m / distance, _MAX_REACH_RAD) / bearings.spacing) + 1
    nearest, found = gate_m * gate_m, -1
    first, last = centre - reach, centre + reach
    if not bearings.closed:
        first, last = max(first, 0), min(last, bearings.beams - 1)
    for k in range(first, last + 1):
        q = k % bearings.beams if bearings.closed else k
        if points[target, q, 2] == 0.0:
            continue
        dx, dy = x - points[target, q, 0], y - points[target, q, 1]
        squared = dx * dx + dy * dy
        if squared < nearest:
            nearest, found = squared, q
    if found >= 0:
        return found
    # On a distant wall the beams are farther apart than the gate.
    q = centre % bearings.beams if bearings.closed else centre
    if q < 0 or q >= bearings.beams or points[target, q, 2] == 0.0:
        return -1
    dx, dy = x - points[target, q, 0], y - points[target, q, 1]
    sparse = _SPARSE_CELLS * bearings.spacing * points[target, q, 2]
    return q if dx * dx + dy * dy <= sparse * sparse else -1


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def add_one_way(returns: Returns, target: int, source: int, pose: Array, loss: Loss, sums: Array) -> None:
    """Add the points of `source`, at `pose` (3,) in the target's frame, on the lines of `target` to `sums` (SUMS,).

    Hessian and gradient are by (x, y, theta) of the pose, of half the weighted squares, m.
    """
    points, normals = returns.points, returns.normals
    x, y, c, s = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    for k in range(0, returns.bearings.beams, returns.bearings.stride):
        if points[source, k, 2] == 0.0:
            continue
        dx = c * points[source, k, 0] - s * points[source, k, 1]
        dy = s * points[source, k, 0] + c * points[source, k, 1]
        q = partner(returns, target, x + dx, y + dy, loss.gate_m)
        if q < 0:
            continue
        nx, ny = float(normals[target, q, 0]), float(normals[target, q, 1])
        if nx == 0.0 and ny == 0.0:
            continue
        mx, my = normals[source, k, 0], normals[source, k, 1]
        if (mx != 0.0 or my != 0.0) and (c * mx - s * my) * nx + (s * mx + c * my) * ny < NORMALS_AGREE:
            continue
        r = nx * (x + dx - points[target, q, 0]) + ny * (y + dy - points[target, q, 1])
        if abs(r) > loss.gate_m:
            continue
        weight = 1.0 / (1.0 + (r / loss.scale_m) ** 2)
        turn = ny * dx - nx * dy  # of r by theta
        _add_square(sums, HESSIAN, weight, nx, ny, turn)
        sums[GRADIENT] += weight * nx * r
        sums[GRADIENT + 1] += weight * ny * r
        sums[GRADIENT + 2] += weight * turn * r
        sums[WEIGHT] += weight
        sums[HITS] += 1.0
        sums[SQUARES] += weight * r * r
        # The same line turned by a quarter: what an error of the normal's angle adds to the Hessian.
        _add_square(sums, SPREAD, weight * normals[target, q, 2], -ny, nx, nx * dx + ny * dy)


@numba.njit(cache=True, error_model="numpy")
def _add_square(sums: Array, at: int, weight: float, a: float, b: float, c: float) -> None:
    """Add the upper triangle of weight * (a, b, c) (a, b, c)^T at a place of the sums."""
    sums[at] += weight * a * a
    sums[at + 1] += weight * a * b
    sums[at + 2] += weight * a * c
    sums[at + 3] += weight * b * b
    sums[at + 4] += weight * b * c
    sums[at + 5] += weight * c * c


@numba.njit(cache=True, error_model="numpy")
def inverse(pose: Array) -> Array:
    """(3,) `T_b_a` of `T_a_b`; the angle is not wrapped."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


@numba.njit(cache=True, error_model="numpy")
def add_both_ways(returns: Returns, target: int, source: int, pose: Array, loss: Loss, sums: Array) -> None:
    """As `add_one_way`, and the points of `target` on the lines of `source`, by the same pose."""
    add_one_way(returns, target, source, pose, loss, sums)
    back, reverse = np.zeros(SUMS), inverse(pose)
    add_one_way(returns, source, target, reverse, loss, back)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    # Jacobian of the inverse pose by the pose.
    jacobian = np.array([[-c, -s, reverse[1]], [s, -c, -reverse[0]], [0.0, 0.0, -1.0]])
    sums[GRADIENT : GRADIENT + 3] += jacobian.T @ back[GRADIENT : GRADIENT + 3].copy()
    for at in (HESSIAN, SPREAD):
        add_matrix(sums, at, jacobian.T @ matrix(back, at) @ jacobian)
    for k in (WEIGHT, HITS, SQUARES):
        sums[k] += back[k]


@numba.njit(cache=True, error_model="numpy")
def matrix(sums: Array, at: int) -> Array:
    """(3, 3) symmetric matrix at a place of the sums."""
    a, b, c, d, e, f = sums[at], sums[at + 1], sums[at + 2], sums[at + 3], sums[at + 4], sums[at + 5]
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


@numba.njit(cache=True, error_model="numpy")
def next_step(step: int, gates_m: Array, shift_m: float, turn: float) -> int:
    """The step after `step`: the next gate, or the first of the last width where the pose hardly moves any more."""
    last = len(gates_m) - 1
    while last > 0 and gates_m[last - 1] == gates_m[-1]:
        last -= 1
    return max(step + 1, last) if shift_m < _NEAR_M and turn < _NEAR_RAD else step + 1


@numba.njit(cache=True, error_model="numpy")
def turned(sums: Array, at: int, c: float, s: float) -> Array:
    """(3, 3) symmetric matrix at a place of the sums, in axes turned by an angle of cosine c and sine s.

    Written out: for matrices of this size a call of BLAS takes longer than the product.
    """
    xx, xy, xt, yy, yt, tt = sums[at], sums[at + 1], sums[at + 2], sums[at + 3], sums[at + 4], sums[at + 5]
    a = c * c * xx - 2.0 * c * s * xy + s * s * yy
    b = c * s * (xx - yy) + (c * c - s * s) * xy
    d = s * s * xx + 2.0 * c * s * xy + c * c * yy
    e, f = c * xt - s * yt, s * xt + c * yt
    return np.array([[a, b, e], [b, d, f], [e, f, tt]])


@numba.njit(cache=True, error_model="numpy")
def solved(a: Array, b: Array) -> Array:
    """(3,) solution of the symmetric, positive definite system a (3, 3), b (3,), by its Cholesky factors."""
    l00 = math.sqrt(a[0, 0])
    l10, l20 = a[1, 0] / l00, a[2, 0] / l00
    l11 = math.sqrt(a[1, 1] - l10 * l10)
    l21 = (a[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(a[2, 2] - l20 * l20 - l21 * l21)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    return np.array([(y0 - l10 * x1 - l20 * x2) / l00, x1, x2])


@numba.njit(cache=True, error_model="numpy")
def add_matrix(sums: Array, at: int, value: Array) -> None:
    """Add a symmetric (3, 3) matrix at a place of the sums."""
    k = at
    for i in range(3):
        for j in range(i, 3):
            sums[k] += value[i, j]
            k += 1
