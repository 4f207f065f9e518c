"""Alignment of scans: points of one on the lines of another, by a robust Gauss-Newton iteration.

A point's partner is found by its bearing, as in a projection (Blais and Levine, "Registering multiview range data to
create 3D computer objects", PAMI 17(8), 1995). The distance is that from the partner's line (Censi, "An ICP variant
using a point-to-line metric", ICRA 2008). Partners whose normals disagree belong to two faces of one wall, and are left
out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.returns import Bearings, cell_of
from sixthsense.core.se2 import between, inverse, inverse_covariance, product, triple, wrapped
from sixthsense.slam.scans.returns import Returns, bearings_at

_MAX_REACH_RAD = 0.21  # to either side that a partner is searched in
_SINE_OF_REACH = math.sin(_MAX_REACH_RAD) / _MAX_REACH_RAD  # at most sin(a) / a up to there
NORMALS_AGREE = 0.7  # least cosine between the normals of partners
_SPARSE_CELLS = 6  # where beams are far apart, the partner may be this many beam spacings away
SIGMA_M = 0.03
"""sigma of a return's distance from a line: noise, roughness and curvature of real walls"""
SCALE_M = 0.05
"""scale of the Cauchy loss on that distance"""
SURFACE_M = 4.0 * SIGMA_M
"""nearer returns are of one surface; the last gate of partners"""
_NARROWER = 0.8  # ratio of one gate to the gate before
_MOST_STEPS = 14
_NEAR_M = 0.02  # smaller steps end the wide gates
_STEP_M = 0.01 * SIGMA_M  # smaller steps end the iteration
_M_PER_RAD = 3.0  # a turn as a step


class Prior(NamedTuple):
    """What is known of a pose without the scans, such as by odometry."""

    pose: Array
    """(3,)"""
    information: Array
    """(3, 3) of the error of (x, y, theta), axes of the frame of the pose"""
    slip_sigmas: float = math.inf
    """scale of the Cauchy loss on the distance from it; infinite for none"""


class Views(NamedTuple):
    """A scan and those that it is aligned with."""

    returns: Returns
    source: int
    """row of the scan"""
    targets: NDArray[np.int64]
    """(R,) rows of the others"""
    at: Array
    """(R, 3) their poses, in the frame of the pose that is sought"""
    factor: float
    """of the variance of a return"""


class Sums(NamedTuple):
    """Sums over pairs of a point and a line; sums of m pairs of scans have a row for each."""

    hessian: Array
    """(3, 3) of half the weighted squares by (x, y, theta) of the source's pose"""
    feigned: Array
    """(3, 3) what the noise of the normals adds to it"""
    gradient: Array
    """(3,)"""
    partners: Array
    """(1,) number of pairs"""


@numba.njit(cache=True, error_model="numpy")
def no_sums(pairs: int) -> Sums:
    """Sums of so many pairs of scans, zero."""
    return Sums(np.zeros((pairs, 3, 3)), np.zeros((pairs, 3, 3)), np.zeros((pairs, 3)), np.zeros(pairs))


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def _nearest(points: NDArray[np.float32], bearings: Bearings, x: float, y: float, gate_m: float) -> int:
    """The cell of the return, among `points` (beams, 3), that is nearest to (x, y); -1 for none.

    It lies within the gate, or where beams are farther apart than that, within a few beam spacings.
    """
    beams = bearings.beams
    centre = math.floor(cell_of(bearings, math.atan2(y, x)) + 0.5)
    # A return n cells away lies at least n - 1 cells from the point's direction, and so far from the point, at least.
    apart = (_SINE_OF_REACH * bearings.spacing) ** 2 * (x * x + y * y)
    nearest, found = gate_m * gate_m, -1
    for n in range(int(_MAX_REACH_RAD / bearings.spacing) + 2):
        if n > 1 and apart * (n - 1) * (n - 1) >= nearest:
            break
        for q in (centre - n, centre + n):
            if q < 0 or q >= beams:
                if not bearings.closed:
                    continue
                q %= beams
            dx, dy = x - points[q, 0], y - points[q, 1]
            squared = dx * dx + dy * dy
            if squared < nearest and points[q, 2] > 0.0:
                nearest, found = squared, q
    if found >= 0:
        return found
    # On a distant wall the beams are farther apart than the gate.
    q = centre % beams if bearings.closed else centre
    if q < 0 or q >= beams or points[q, 2] == 0.0:
        return -1
    dx, dy = x - points[q, 0], y - points[q, 1]
    sparse = _SPARSE_CELLS * bearings.spacing * points[q, 2]
    return q if dx * dx + dy * dy <= sparse * sparse else -1


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def partners_of(
    returns: Returns, target: int, source: int, pose: Array, gate_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(k,) the cell of each moved return's partner, or -1, and (beams,) how many returns a cell is the partner of."""
    bearings, own = bearings_at(returns, target), bearings_at(returns, source)
    points, normals = returns.points[target], returns.normals[target]
    moved, turned_normals = returns.points[source], returns.normals[source]
    x, y, c, s = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    found = np.full((own.beams - 1) // own.stride + 1, -1)
    shared = np.zeros(bearings.beams, dtype=np.int64)
    for i in range(len(found)):
        k = i * own.stride
        if moved[k, 2] == 0.0:
            continue
        px, py = moved[k, 0], moved[k, 1]
        px, py = x + (c * px - s * py), y + (s * px + c * py)
        q = _nearest(points, bearings, px, py, gate_m)
        if q < 0:
            continue
        nx, ny = normals[q, 0], normals[q, 1]
        if nx == 0.0 and ny == 0.0:
            continue
        mx, my = turned_normals[k, 0], turned_normals[k, 1]
        if (mx != 0.0 or my != 0.0) and (c * mx - s * my) * nx + (s * mx + c * my) * ny < NORMALS_AGREE:
            continue
        if abs(nx * (px - points[q, 0]) + ny * (py - points[q, 1])) > gate_m:
            continue
        found[i] = q
        shared[q] += 1
    return found, shared


class Axes(NamedTuple):
    """How distances from the lines of a scan depend on the pose that is sought."""

    x: float
    """position of the source's laser in the frame of the lines, m"""
    y: float
    heading: float
    """of the frame of the lines in the frame of the pose, rad"""
    sign: float
    """1 for lines of a target, -1 for lines of the source"""


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def add(returns: Returns, lines: int, points: int, pose: Array, axes: Axes, gate_m: float, sums: Sums) -> None:
    """Add the points of one scan, at `pose` (3,) in the frame of another scan, on the lines of that one to `sums`.

    Points with one partner share its error: n of them count as 2 n / (n + 1) pairs, two at most. A near scan puts many
    on a far one's return.
    """
    per_scale = 1.0 / SCALE_M
    at, normals, moved = returns.points[lines], returns.normals[lines], returns.points[points]
    x, y, c, s = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    to_c, to_s = math.cos(axes.heading), math.sin(axes.heading)
    stride = bearings_at(returns, points).stride
    partners, shared = partners_of(returns, lines, points, pose, gate_m)
    # Numbers instead of arrays: a compiler keeps them in registers.
    xx = xy = xt = yy = yt = tt = gx = gy = gt = count = fxx = fxy = fxt = fyy = fyt = ftt = 0.0
    for i in range(len(partners)):
        q, k = partners[i], i * stride
        if q < 0:
            continue
        px, py = x + (c * moved[k, 0] - s * moved[k, 1]), y + (s * moved[k, 0] + c * moved[k, 1])
        nx, ny = float(normals[q, 0]), float(normals[q, 1])
        r = nx * (px - at[q, 0]) + ny * (py - at[q, 1])
        pairs = 2.0 / (1.0 + shared[q])
        weight = pairs / (1.0 + (r * per_scale) ** 2)
        dx, dy = px - axes.x, py - axes.y
        # The derivatives by theta of the distance, and of the distance from the line turned by a quarter.
        turn, along = ny * dx - nx * dy, nx * dx + ny * dy
        nx, ny = to_c * nx - to_s * ny, to_s * nx + to_c * ny
        wx, wy, wt = weight * nx, weight * ny, weight * turn
        xx, xy, xt = xx + wx * nx, xy + wx * ny, xt + wx * turn
        yy, yt, tt = yy + wy * ny, yt + wy * turn, tt + wt * turn
        gx, gy, gt = gx + wx * r, gy + wy * r, gt + wt * r
        count += pairs
        # An error of the normal's angle moves the distance by the turned line's derivatives.
        feigned = weight * normals[q, 2]
        fx, fy = -feigned * ny, feigned * nx
        fxx, fxy, fxt = fxx - fx * ny, fxy + fx * nx, fxt + fx * along
        fyy, fyt, ftt = fyy + fy * nx, fyt + fy * along, ftt + feigned * along * along
    _add_symmetric(sums.hessian, (xx, xy, xt, yy, yt, tt))
    _add_symmetric(sums.feigned, (fxx, fxy, fxt, fyy, fyt, ftt))
    for i, gradient in enumerate((gx, gy, gt)):
        sums.gradient[i] += axes.sign * gradient
    sums.partners[0] += count


@numba.njit(cache=True, error_model="numpy")
def _add_symmetric(out: Array, upper: tuple[float, float, float, float, float, float]) -> None:
    """Add the matrix (3, 3) with these entries, from the diagonal on in each row."""
    for i, j, value in ((0, 0, upper[0]), (0, 1, upper[1]), (0, 2, upper[2]), (1, 1, upper[3]), (1, 2, upper[4])):
        out[i, j] += value
        if i != j:
            out[j, i] += value
    out[2, 2] += upper[5]


@numba.njit(cache=True, error_model="numpy")
def add_all(views: Views, pose: Array, gate_m: float, both: bool, sums: Sums) -> None:
    """Compute `sums` over the targets, of the source at `pose` (3,) on their lines, and if `both` the other way round.

    Axes are those of the frame of the pose.
    """
    sums.hessian[:], sums.feigned[:], sums.gradient[:], sums.partners[:] = 0.0, 0.0, 0.0, 0.0
    for r in range(len(views.targets)):
        seen, heading = between(triple(views.at[r]), triple(pose)), views.at[r, 2]
        lines, points, at, axes = views.targets[r], views.source, seen, Axes(seen[0], seen[1], heading, 1.0)
        for _ in range(1 + both):
            add(views.returns, lines, points, np.array(at), axes, gate_m, sums)
            lines, points, at, axes = points, lines, inverse(seen), Axes(0.0, 0.0, pose[2], -1.0)


@numba.njit(cache=True, error_model="numpy")
def align(views: Views, prior: Prior, gate_m: float, both: bool, pose: Array, sums: Sums) -> None:
    """Gauss-Newton steps of the pose of a scan among others, from and into `pose` (3,).

    `sums` are computed at the pose before the last step. `gate_m` is the first gate: it narrows step by step, and at
    once where the pose hardly moves any more.
    """
    # Each return of the source is counted once for each target, and has one error.
    scale = 1.0 / (SIGMA_M * SIGMA_M * views.factor * max(1, len(views.targets)))
    gate = max(gate_m, SURFACE_M)
    for _ in range(_MOST_STEPS):
        add_all(views, pose, gate, both, sums)
        move = _step(prior, scale, pose, sums)
        for i in range(3):
            pose[i] += move[i]
        moved_m = abs(move[0]) + abs(move[1]) + _M_PER_RAD * abs(move[2])
        if gate == SURFACE_M and moved_m < _STEP_M:
            break
        gate = SURFACE_M if moved_m < _NEAR_M else max(_NARROWER * gate, SURFACE_M)
    pose[2] = wrapped(pose[2])


@numba.njit(cache=True, error_model="numpy")
def _step(prior: Prior, scale: float, pose: Array, sums: Sums) -> Array:
    """(3,) step of the pose for the sums there, which are multiplied with `scale`, and the prior."""
    off = np.array((pose[0] - prior.pose[0], pose[1] - prior.pose[1], wrapped(pose[2] - prior.pose[2])))
    pull = product(prior.information, off)
    square = off[0] * pull[0] + off[1] * pull[1] + off[2] * pull[2]
    weight = 1.0 / (1.0 + square / (prior.slip_sigmas * prior.slip_sigmas))
    system, downhill = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        downhill[i] = -(scale * sums.gradient[i] + weight * pull[i])
        for j in range(3):
            system[i, j] = scale * sums.hessian[i, j] + weight * prior.information[i, j]
    return product(inverse_covariance(system), downhill)
