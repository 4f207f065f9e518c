"""Normals of a scan's returns: a line through the neighbouring returns of the same surface."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.scans.bearings import Bearings

_GRAZING_RAD = 0.12  # flattest angle between beam and surface at which neighbours belong together
_JUMP_M = 0.06  # distance between neighbours of one surface that is always allowed
_REACH_M = 0.12  # the line is fitted to the returns up to this distance to either side
_MIN_STEPS, _MAX_STEPS = 2, 16  # beams to either side, however near or far they are
_MIN_POINTS = 4
_MAX_ASPECT = 0.06  # largest ratio of the variances across and along the line


@numba.njit(cache=True, error_model="numpy")
def fit_normals(returns: NDArray[np.float32], bearings: Bearings, out: NDArray[np.float32]) -> None:
    """Write the normal (x, y) of each return, towards the laser, and the variance of its angle into `out` (beams, 3).

    `returns` (beams, 3): x, y and range, 0 where there is none. A return without a normal has (0, 0, 0).
    """
    out[:] = 0.0
    jump = math.sin(bearings.spacing) / math.sin(_GRAZING_RAD)
    for i in range(bearings.beams):
        if returns[i, 2] == 0.0:
            continue
        before = _steps(returns, bearings, i, -1, jump)
        after = _steps(returns, bearings, i, 1, jump)
        n = before + after + 1
        if n < _MIN_POINTS - (before > 0 and after > 0):
            continue
        mx = my = sxx = sxy = syy = 0.0
        first = i - before if i >= before else i - before + bearings.beams
        q = first
        for _ in range(n):
            mx += returns[q, 0]
            my += returns[q, 1]
            q = q + 1 if q + 1 < bearings.beams else 0
        mx, my = mx / n, my / n
        q = first
        for _ in range(n):
            dx, dy = returns[q, 0] - mx, returns[q, 1] - my
            sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
            q = q + 1 if q + 1 < bearings.beams else 0
        # Half of the angle atan2(2 sxy, sxx - syy), by its cosine.
        double = (sxx - syy) / max(math.sqrt((sxx - syy) ** 2 + 4.0 * sxy * sxy), 1e-300)
        c, s = math.sqrt(0.5 * (1.0 + double)), math.copysign(math.sqrt(0.5 * max(1.0 - double, 0.0)), sxy)
        along = sxx * c * c + 2.0 * sxy * c * s + syy * s * s
        across = max(sxx + syy - along, 0.0)
        if across > _MAX_ASPECT * along:
            continue
        nx, ny = -s, c
        if nx * returns[i, 0] + ny * returns[i, 1] > 0.0:
            nx, ny = -nx, -ny
        out[i, 0], out[i, 1], out[i, 2] = nx, ny, across / ((n - 2) * along)


@numba.njit(cache=True, error_model="numpy")
def _steps(returns: NDArray[np.float32], bearings: Bearings, i: int, side: int, jump: float) -> int:
    """How many returns to one side of return `i` belong to its surface and its surroundings."""
    steps, last = 0, i
    while steps < _MAX_STEPS:
        q = last + side
        if bearings.closed:
            q %= bearings.beams
        if q < 0 or q >= bearings.beams or returns[q, 2] == 0.0:
            break
        dx, dy = returns[q, 0] - returns[last, 0], returns[q, 1] - returns[last, 1]
        allowed = _JUMP_M + jump * min(returns[q, 2], returns[last, 2])
        if dx * dx + dy * dy > allowed * allowed:
            break
        steps, last = steps + 1, q
        dx, dy = returns[q, 0] - returns[i, 0], returns[q, 1] - returns[i, 1]
        if steps >= _MIN_STEPS and dx * dx + dy * dy > _REACH_M * _REACH_M:
            break
    return steps
