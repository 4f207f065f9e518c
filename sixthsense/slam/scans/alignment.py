"""Point-to-line alignment of a scan with others: residuals, a prior, and a loss whose gate narrows.

A point of the source scan, seen from the target's laser, falls into a cell of bearings; the nearest return in the cells
around is its partner, and the residual is its distance from the partner's line. Partners' normals must agree, so that
the two faces of a thin wall are never confused (Censi, "An ICP variant using a point-to-line metric", ICRA 2008;
Blais and Levine, "Registering multiview range data to create 3D computer objects", PAMI 17(8), 1995).
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import inverse, product, triple
from sixthsense.slam.scans.returns import Bearings, Returns, bearings_at, cell_of, direction

_MAX_REACH_RAD = 0.21  # to either side that a partner is searched in
_SINE_OF_REACH = 0.99  # less than sin(a) / a up to there
NORMALS_AGREE = 0.7  # least cosine between the normals of partners
_SPARSE_CELLS = 6  # where beams are far apart, the partner may be this many beam spacings away


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def partner(returns: Returns, target: int, x: float, y: float, gate_m: float) -> int:
    """The cell of the target's return that is nearest to a point in the target's frame; -1 for none within the gate."""
    return _nearest(returns.points[target], bearings_at(returns, target), x, y, gate_m)


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def _nearest(points: NDArray[np.float32], bearings: Bearings, x: float, y: float, gate_m: float) -> int:
    """As `partner`, among the returns `points` (beams, 3) of one scan."""
    beams = bearings.beams
    centre = math.floor(cell_of(bearings, direction(x, y)) + 0.5)
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


SIGMA_M = 0.03  # of a return's distance from a line: noise, roughness and curvature of real walls
SCALE_M = 0.05  # of the Cauchy loss on that distance
SURFACE_M, _NARROWER = 0.12, 0.8  # nearer returns are of one surface: the last gate; and the ratio of one to the next
_MOST_STEPS = 14
_NEAR_M, _NEAR_RAD = 0.02, 0.005  # a smaller step says that the wide gates have done their work
_STEP_M, _STEP_RAD = 3e-4, 1e-4  # a smaller step ends the iteration

HESSIAN, GRADIENT, WEIGHT, HITS, SQUARES, SPREAD, SUMS = itertools.accumulate((6, 3, 1, 1, 1, 6), initial=0)
"""Places in the sums: Hessian (upper triangle), gradient, weights, partners, squares, Hessian of the normals' noise."""


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
    factor: float = 1.0
    """of the variance of a return"""


class Loss(NamedTuple):
    """How residuals count."""

    gate_m: float
    """largest distance of partners"""
    scale_m: float
    """of the Cauchy loss"""


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def add_one_way(returns: Returns, target: int, source: int, pose: Array, loss: Loss, sums: Array) -> None:
    """Add the points of `source`, at `pose` (3,) in the target's frame, on the lines of `target` to `sums` (SUMS,).

    Hessian and gradient are by (x, y, theta) of the pose, of half the weighted squares, m. Returns with one partner
    share its error: n of them are worth 2 n / (n + 1) pairs, two at most. A near scan puts many on a far one's return.
    """
    per_scale = 1.0 / loss.scale_m
    points, normals, moved = returns.points[target], returns.normals[target], returns.points[source]
    x, y, c, s = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    stride = bearings_at(returns, source).stride
    partners, shared = partners_of(returns, target, source, pose, loss.gate_m)
    # Numbers instead of rows of `sums`: a compiler keeps them in registers.
    xx = xy = xt = yy = yt = tt = gx = gy = gt = weights = hits = squares = fxx = fxy = fxt = fyy = fyt = ftt = 0.0
    for i in range(len(partners)):
        q, k = partners[i], i * stride
        if q < 0:
            continue
        px, py = moved[k, 0], moved[k, 1]
        dx, dy = c * px - s * py, s * px + c * py
        nx, ny = float(normals[q, 0]), float(normals[q, 1])
        r = nx * (x + dx - points[q, 0]) + ny * (y + dy - points[q, 1])
        pairs = 2.0 / (1.0 + shared[q])
        weight = pairs / (1.0 + (r * per_scale) ** 2)
        turn = ny * dx - nx * dy  # of r by theta
        wx, wy, wt = weight * nx, weight * ny, weight * turn
        xx, xy, xt = xx + wx * nx, xy + wx * ny, xt + wx * turn
        yy, yt, tt = yy + wy * ny, yt + wy * turn, tt + wt * turn
        gx, gy, gt = gx + wx * r, gy + wy * r, gt + wt * r
        weights, hits, squares = weights + weight, hits + pairs, squares + weight * r * r
        # The same line turned by a quarter: what an error of the normal's angle adds to the Hessian.
        along, feigned = nx * dx + ny * dy, weight * normals[q, 2]
        fx, fy = -feigned * ny, feigned * nx
        fxx, fxy, fxt = fxx - fx * ny, fxy + fx * nx, fxt + fx * along
        fyy, fyt, ftt = fyy + fy * nx, fyt + fy * along, ftt + feigned * along * along
    found = (xx, xy, xt, yy, yt, tt, gx, gy, gt, weights, hits, squares, fxx, fxy, fxt, fyy, fyt, ftt)
    for i in range(SUMS):
        sums[i] += found[i]


@numba.njit(cache=True, error_model="numpy")
def add_both_ways(returns: Returns, target: int, source: int, pose: Array, loss: Loss, sums: Array) -> None:
    """As `add_one_way`, and the points of `target` on the lines of `source`, by the same pose."""
    add_one_way(returns, target, source, pose, loss, sums)
    back, reverse = np.zeros(SUMS), np.array(inverse(triple(pose)))
    add_one_way(returns, source, target, reverse, loss, back)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    # The Jacobian of the inverse pose by the pose is [[-c, -s, u], [s, -c, v], [0, 0, -1]].
    u, v = reverse[1], -reverse[0]
    gx, gy = back[GRADIENT], back[GRADIENT + 1]
    sums[GRADIENT] += s * gy - c * gx
    sums[GRADIENT + 1] -= s * gx + c * gy
    sums[GRADIENT + 2] += u * gx + v * gy - back[GRADIENT + 2]
    for at in (HESSIAN, SPREAD):
        _add_reversed(sums, at, back, (c, s, u, v))
    for k in (WEIGHT, HITS, SQUARES):
        sums[k] += back[k]


@numba.njit(cache=True, error_model="numpy")
def _add_reversed(sums: Array, at: int, back: Array, jacobian: tuple[float, float, float, float]) -> None:
    """Add the symmetric matrix at a place of `back`, by the inverse pose, to that of `sums`, by the pose."""
    c, s, u, v = jacobian
    xx, xy, xt, yy, yt, tt = back[at], back[at + 1], back[at + 2], back[at + 3], back[at + 4], back[at + 5]
    # Columns of the matrix times the Jacobian.
    ax, ay = s * xy - c * xx, s * yy - c * xy
    bx, by = -s * xx - c * xy, -s * xy - c * yy
    tx, ty, t = u * xx + v * xy - xt, u * xy + v * yy - yt, u * xt + v * yt - tt
    sums[at] += s * ay - c * ax
    sums[at + 1] += s * by - c * bx
    sums[at + 2] += s * ty - c * tx
    sums[at + 3] -= s * bx + c * by
    sums[at + 4] -= s * tx + c * ty
    sums[at + 5] += u * tx + v * ty - t


@numba.njit(cache=True, error_model="numpy")
def matrix(sums: Array, at: int) -> Array:
    """(3, 3) symmetric matrix at a place of the sums."""
    out, k = np.empty((3, 3)), at
    for i in range(3):
        for j in range(i, 3):
            out[i, j] = out[j, i] = sums[k]
            k += 1
    return out


@numba.njit(cache=True, error_model="numpy")
def told(sums: Array, over: float) -> Array:
    """(3, 3) Hessian over a number, without what the normals' noise adds to it."""
    out, k = np.empty((3, 3)), 0
    for i in range(3):
        for j in range(i, 3):
            out[i, j] = out[j, i] = (sums[HESSIAN + k] - sums[SPREAD + k]) / over
            k += 1
    return out


@numba.njit(cache=True, error_model="numpy")
def _add_turned(sums: Array, at: int, own: Array, c: float, s: float) -> None:
    """Add the symmetric matrix at a place of `own`, in axes turned by an angle of cosine c and sine s, to `sums`."""
    xx, xy, xt, yy, yt, tt = own[at], own[at + 1], own[at + 2], own[at + 3], own[at + 4], own[at + 5]
    sums[at] += c * c * xx - 2.0 * c * s * xy + s * s * yy
    sums[at + 1] += c * s * (xx - yy) + (c * c - s * s) * xy
    sums[at + 2] += c * xt - s * yt
    sums[at + 3] += s * s * xx + 2.0 * c * s * xy + c * c * yy
    sums[at + 4] += s * xt + c * yt
    sums[at + 5] += tt


@numba.njit(cache=True, error_model="numpy")
def add_all(views: Views, pose: Array, loss: Loss, both: bool, sums: Array) -> float:
    """Sum of `add_one_way`, or `add_both_ways` if `both`, over the targets, into `sums` (SUMS,), axes of their frame.

    `pose` (3,) is that of the source. Returns the largest weight of one target: targets that see the same surfaces
    count once.
    """
    returns, source, targets, at = views.returns, views.source, views.targets, views.at
    sums[:] = 0.0
    most = 0.0
    for r in range(len(targets)):
        c, s = math.cos(at[r, 2]), math.sin(at[r, 2])
        dx, dy = pose[0] - at[r, 0], pose[1] - at[r, 1]
        seen = np.array((c * dx + s * dy, c * dy - s * dx, pose[2] - at[r, 2]))
        own = np.zeros(SUMS)
        if both:
            add_both_ways(returns, targets[r], source, seen, loss, own)
        else:
            add_one_way(returns, targets[r], source, seen, loss, own)
        for place in (HESSIAN, SPREAD):
            _add_turned(sums, place, own, c, s)
        gx, gy = own[GRADIENT], own[GRADIENT + 1]
        sums[GRADIENT] += c * gx - s * gy
        sums[GRADIENT + 1] += s * gx + c * gy
        sums[GRADIENT + 2] += own[GRADIENT + 2]
        for k in (WEIGHT, HITS, SQUARES):
            sums[k] += own[k]
        most = max(most, own[WEIGHT])
    return most


@numba.njit(cache=True, error_model="numpy")
def align(views: Views, prior: Prior, gate_m: float, both: bool, pose: Array, sums: Array) -> float:
    """Gauss-Newton steps of the pose of a scan among others, from and into `pose` (3,); fills `sums` (SUMS,).

    Arguments as in `add_all`. `gate_m` is the first gate: it narrows step by step, and at once where the pose hardly
    moves any more. Returns the largest weight of one target.
    """
    scale = 1.0 / (SIGMA_M * SIGMA_M * views.factor * max(1, len(views.targets)))
    gate, most = max(gate_m, SURFACE_M), 0.0
    for _ in range(_MOST_STEPS):
        most = add_all(views, pose, Loss(gate, SCALE_M), both, sums)
        move = _step(prior, scale, pose, sums)
        for i in range(3):
            pose[i] += move[i]
        shift, turn = abs(move[0]) + abs(move[1]), abs(move[2])
        if gate == SURFACE_M and shift < _STEP_M and turn < _STEP_RAD:
            break
        gate = max(_NARROWER * gate, SURFACE_M)
        if shift < _NEAR_M and turn < _NEAR_RAD:
            gate = SURFACE_M
    pose[2] = (pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    return most


@numba.njit(cache=True, error_model="numpy")
def _step(prior: Prior, scale: float, pose: Array, sums: Array) -> Array:
    """(3,) step of the pose for the sums there, which are multiplied with `scale`, and the prior."""
    off, system, downhill = np.empty(3), matrix(sums, HESSIAN), np.empty(3)
    for i in range(3):
        off[i] = pose[i] - prior.pose[i]
    off[2] = (off[2] + math.pi) % (2.0 * math.pi) - math.pi
    pull = product(prior.information, off)
    square = off[0] * pull[0] + off[1] * pull[1] + off[2] * pull[2]
    weight = 1.0 / (1.0 + square / (prior.slip_sigmas * prior.slip_sigmas))
    for i in range(3):
        downhill[i] = -(scale * sums[GRADIENT + i] + weight * pull[i])
        for j in range(3):
            system[i, j] = scale * system[i, j] + weight * prior.information[i, j]
    return solved(system, downhill)


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
    return np.array(((y0 - l10 * x1 - l20 * x2) / l00, x1, x2))
