"""Partners: the returns of one scan that those of another one lie on.

A point of the source scan, seen from the target's laser, falls into a cell of bearings; the nearest return in the cells
around is its partner. Partners' normals must agree, so that the two faces of a thin wall are never confused (Blais and
Levine, "Registering multiview range data to create 3D computer objects", PAMI 17(8), 1995).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.bearings import Bearings, cell_of, direction
from sixthsense.slam.scans.scan_store import Returns, bearings_at

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
