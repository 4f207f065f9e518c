"""Returns of a scan by bearing: cells as the laser sees them, and the normals of the surfaces that they lie on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.se2 import Array

NO_BEAM = -1.0
"""range of a cell of which no beam says anything"""
_MOST_MOVED = 200  # returns: a laser with finer beams adds time and little else


class Bearings(NamedTuple):
    """Cells of equal angle, counter-clockwise; cell i is centred at `first + i * spacing`."""

    first: float
    """rad, laser's frame"""
    spacing: float
    """rad, positive"""
    beams: int
    """number of cells"""
    closed: bool
    """whether the first cell follows the last"""
    blind: float
    """rad, half of the sector between the last cell and the first"""
    stride: int
    """an alignment moves the returns of every so many cells"""


def bearings_of(angle_min: float, angle_increment: float, beams: int, closed: bool) -> Bearings:
    """The cells of so many beams from an angle on, rad; `closed` is whether the first one follows the last."""
    spacing, last = abs(angle_increment), angle_min + angle_increment * (beams - 1)
    closed = closed or abs(beams * spacing - 2.0 * math.pi) < 0.5 * spacing
    blind = 0.5 * spacing if closed else 0.5 * max(2.0 * math.pi - (beams - 1) * spacing, 0.0)
    return Bearings(min(angle_min, last), spacing, beams, closed, blind, max(1, round(beams / _MOST_MOVED)))


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def cell_of(bearings: Bearings, angle: float) -> float:
    """The cell of a direction, rad, as a real number; outside 0 to beams - 1 in the blind sector."""
    offset = angle - bearings.first
    while offset < -bearings.blind:
        offset += 2.0 * math.pi
    while offset >= 2.0 * math.pi - bearings.blind:
        offset -= 2.0 * math.pi
    return offset / bearings.spacing


@numba.njit(cache=True, error_model="numpy")
def by_bearing(ranges: NDArray[np.float32], angles: Array, bearings: Bearings, max_range: float) -> NDArray[np.float32]:
    """(beams, 3) x, y and range of each cell's return, the nearest where two share a cell.

    `ranges` (N,) m and `angles` (N,) rad in the laser's frame. The range is 0 where all beams met nothing up to
    `max_range`, and `NO_BEAM` where there is none, or one that is no evidence.
    """
    out = np.zeros((bearings.beams, 3), np.float32)
    out[:, 2] = NO_BEAM
    for i in range(len(ranges)):
        r = ranges[i]
        cell = round(cell_of(bearings, angles[i]))
        if bearings.closed:
            cell %= bearings.beams
        if cell < 0 or cell >= bearings.beams or not r > 0.0:
            continue
        if r >= np.float32(max_range):  # as in the ranges, which may code no return so
            out[cell, 2] = max(out[cell, 2], 0.0)
        elif out[cell, 2] <= 0.0 or r < out[cell, 2]:
            out[cell, 0], out[cell, 1], out[cell, 2] = r * math.cos(angles[i]), r * math.sin(angles[i]), r
    return out


_GRAZING_RAD = 0.12  # flattest angle between beam and surface at which neighbours belong together
_JUMP_M = 0.06  # distance between neighbours of one surface that is always allowed
_REACH_M = 0.12  # the line is fitted to the returns up to this distance to either side; to twice that if these are none
_MIN_STEPS, _MAX_STEPS = 2, 16  # beams to either side, however near or far they are
_MIN_POINTS = 4
_MAX_ASPECT = 0.06  # largest ratio of the variances across and along the line


@numba.njit(cache=True, error_model="numpy")
def normals_of(returns: NDArray[np.float32], bearings: Bearings) -> NDArray[np.float32]:
    """(beams, 3) the normal (x, y) of each return, towards the laser, and the variance of its angle, rad^2.

    `returns` (beams, 3) are those of `by_bearing`. A return without a normal has (0, 0, 0). Noise of a few centimetres
    hides a line of a decimetre, and leaves a longer one.
    """
    out = np.zeros_like(returns)
    jump = math.sin(bearings.spacing) / math.sin(_GRAZING_RAD)
    for i in range(bearings.beams):
        if returns[i, 2] <= 0.0:
            continue
        nx, ny, variance = _normal(returns, bearings, i, jump, _REACH_M)
        if variance < 0.0:
            nx, ny, variance = _normal(returns, bearings, i, jump, 2.0 * _REACH_M)
        if variance >= 0.0:
            out[i, 0], out[i, 1], out[i, 2] = nx, ny, variance
    return out


@numba.njit(cache=True, error_model="numpy")
def _normal(
    returns: NDArray[np.float32], bearings: Bearings, i: int, jump: float, reach_m: float
) -> tuple[float, float, float]:
    """Normal (x, y) of a return by those up to a distance to either side, and its angle's variance, -1 for none.

    Neighbours are of one surface where they are no farther apart than on one that the beam meets at a flat angle.
    """
    n, sides, sx, sy, sxx, sxy, syy = 1, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for side in (-1, 1):
        last = i
        for step in range(1, _MAX_STEPS + 1):
            q = (last + side) % bearings.beams if bearings.closed else last + side
            if q < 0 or q >= bearings.beams or returns[q, 2] <= 0.0:
                break
            dx, dy = returns[q, 0] - returns[last, 0], returns[q, 1] - returns[last, 1]
            allowed = _JUMP_M + jump * min(returns[q, 2], returns[last, 2])
            if dx * dx + dy * dy > allowed * allowed:
                break
            last, n, sides = q, n + 1, sides + (step == 1)
            dx, dy = float(returns[q, 0] - returns[i, 0]), float(returns[q, 1] - returns[i, 1])
            sx, sy, sxx, sxy, syy = sx + dx, sy + dy, sxx + dx * dx, sxy + dx * dy, syy + dy * dy
            if step >= _MIN_STEPS and dx * dx + dy * dy > reach_m * reach_m:
                break
    if n < _MIN_POINTS - (sides == 2):
        return 0.0, 0.0, -1.0
    sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    heading = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
    c, s = math.cos(heading), math.sin(heading)
    along = sxx * c * c + 2.0 * sxy * c * s + syy * s * s
    across = max(sxx + syy - along, 0.0)
    if across > _MAX_ASPECT * along:
        return 0.0, 0.0, -1.0
    away = math.copysign(1.0, s * returns[i, 0] - c * returns[i, 1])  # of the normal (s, -c), from the laser
    return -away * s, away * c, across / ((n - 2) * along)
