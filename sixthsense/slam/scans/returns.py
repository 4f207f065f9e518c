"""Returns of scans, kept by bearing: cells as the laser sees them, the normals of their surfaces, and the store of all.

Scans of keyframes are rows of arrays. A row has a cell for each bearing of the laser, so that what a scan saw in a
direction is found without a search.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan

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


def bearings_of(scan: Scan) -> Bearings:
    """The cells of a laser's beams, from one of its scans."""
    spacing, count = abs(float(scan.angle_increment)), len(scan.ranges)
    last = float(scan.angle_min) + float(scan.angle_increment) * (count - 1)
    closed = abs(count * spacing - 2.0 * math.pi) < 0.5 * spacing or scan.closed
    blind = 0.5 * spacing if closed else 0.5 * max(2.0 * math.pi - (count - 1) * spacing, 0.0)
    return Bearings(min(float(scan.angle_min), last), spacing, count, closed, blind, max(1, round(count / _MOST_MOVED)))


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def direction(x: float, y: float) -> float:
    """atan2(y, x) to 1.2e-5 rad, enough to find a cell, in a tenth of the time (Abramowitz and Stegun, eq. 4.4.49)."""
    long, short = max(abs(x), abs(y)), min(abs(x), abs(y))
    if long == 0.0:
        return 0.0
    a = short / long
    s = a * a
    angle = a * (0.9998660 + s * (-0.3302995 + s * (0.1801410 + s * (-0.0851330 + s * 0.0208351))))
    if abs(y) > abs(x):
        angle = 0.5 * math.pi - angle
    if x < 0.0:
        angle = math.pi - angle
    return -angle if y < 0.0 else angle


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
def fill_cells(
    ranges: NDArray[np.float32], angles: Array, bearings: Bearings, max_range: float, out: NDArray[np.float32]
) -> None:
    """Write each return's x, y and range into `out` (beams, 3), the row of its cell; the nearest where two share one.

    `ranges` (N,) m and `angles` (N,) rad in the laser's frame. A cell without a return has range 0. Returns at
    `max_range` or beyond are left out.
    """
    out[:] = 0.0
    for i in range(len(ranges)):
        r = ranges[i]
        if not (0.0 < r < max_range):
            continue
        cell = round(cell_of(bearings, angles[i]))
        if bearings.closed:
            cell %= bearings.beams
        elif cell < 0 or cell >= bearings.beams:
            continue
        if out[cell, 2] == 0.0 or r < out[cell, 2]:
            out[cell, 0], out[cell, 1], out[cell, 2] = r * math.cos(angles[i]), r * math.sin(angles[i]), r


_GRAZING_RAD = 0.12  # flattest angle between beam and surface at which neighbours belong together
_JUMP_M = 0.06  # distance between neighbours of one surface that is always allowed
_REACH_M = 0.12  # the line is fitted to the returns up to this distance to either side; to twice that if these are none
_MIN_STEPS, _MAX_STEPS = 2, 16  # beams to either side, however near or far they are
_MIN_POINTS = 4
_MAX_ASPECT = 0.06  # largest ratio of the variances across and along the line


@numba.njit(cache=True, error_model="numpy")
def fit_normals(returns: NDArray[np.float32], bearings: Bearings, out: NDArray[np.float32]) -> None:
    """Write the normal (x, y) of each return, towards the laser, and the variance of its angle into `out` (beams, 3).

    `returns` (beams, 3): x, y and range, 0 where there is none. A return without a normal has (0, 0, 0). Noise of a few
    centimetres hides a line of a decimetre, and leaves a longer one.
    """
    out[:] = 0.0
    jump = math.sin(bearings.spacing) / math.sin(_GRAZING_RAD)
    for i in range(bearings.beams):
        if returns[i, 2] == 0.0:
            continue
        nx, ny, variance = _normal(returns, bearings, i, jump, _REACH_M)
        if variance < 0.0:
            nx, ny, variance = _normal(returns, bearings, i, jump, 2.0 * _REACH_M)
        if variance >= 0.0:
            out[i, 0], out[i, 1], out[i, 2] = nx, ny, variance


@numba.njit(cache=True, error_model="numpy")
def _normal(
    returns: NDArray[np.float32], bearings: Bearings, i: int, jump: float, reach_m: float
) -> tuple[float, float, float]:
    """Normal (x, y) of a return by those up to a distance to either side, and its angle's variance, -1 for none."""
    before = _steps(returns, bearings, i, -1, jump, reach_m)
    after = _steps(returns, bearings, i, 1, jump, reach_m)
    n = before + after + 1
    if n < _MIN_POINTS - (before > 0 and after > 0):
        return 0.0, 0.0, -1.0
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
        return 0.0, 0.0, -1.0
    nx, ny = -s, c
    if nx * returns[i, 0] + ny * returns[i, 1] > 0.0:
        nx, ny = -nx, -ny
    return nx, ny, across / ((n - 2) * along)


@numba.njit(cache=True, error_model="numpy")
def _steps(returns: NDArray[np.float32], bearings: Bearings, i: int, side: int, jump: float, reach_m: float) -> int:
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
        if steps >= _MIN_STEPS and dx * dx + dy * dy > reach_m * reach_m:
            break
    return steps


_ROWS = 64  # of a store that is empty


class Returns(NamedTuple):
    """Returns of scans, by scan and by bearing; laser's frame, m."""

    points: NDArray[np.float32]
    """(n, beams, 3) x, y and range; range 0 where there is no return, and behind the beams of a scan with fewer"""
    normals: NDArray[np.float32]
    """(n, beams, 3) normal towards the laser and variance of its angle, rad^2; (0, 0, 0) where there is none"""
    cells: Array
    """(n, 6) the `Bearings` of each scan: lasers vary the number and the angles of their beams"""


@numba.njit(cache=True, error_model="numpy")
def bearings_at(returns: Returns, row: int) -> Bearings:
    """The cells of a scan."""
    of = returns.cells[row]
    return Bearings(of[0], of[1], int(of[2]), of[3] != 0.0, of[4], int(of[5]))


@numba.njit(cache=True, error_model="numpy")
def _write(
    returns: Returns, row: int, bearings: Bearings, ranges: NDArray[np.float32], angles: Array, limit: float
) -> None:
    """Write the returns of a scan, with their normals, into a row."""
    fill_cells(ranges, angles, bearings, limit, returns.points[row])
    fit_normals(returns.points[row], bearings, returns.normals[row])
    cells = returns.cells[row]
    cells[0], cells[1], cells[2] = bearings.first, bearings.spacing, bearings.beams
    cells[3], cells[4], cells[5] = bearings.closed, bearings.blind, bearings.stride


class ScanStore:
    """Keyframes, one row each; the row after the last one holds the newest scan until it is kept or replaced."""

    def __init__(self, max_range_m: float) -> None:
        """Begin empty; returns beyond `max_range_m` are not used."""
        self._max_range_m = max_range_m
        self.returns = _zeros(_ROWS, 0)
        """the arrays, with `count` scans, then the newest one, then rows without meaning"""
        self.centres = np.zeros((_ROWS, 3))
        """(n, 3) middle of what each scan sees, in its frame, as a pose without a turn"""
        self.count = 0
        """number of scans kept"""

    def put(self, scan: Scan) -> int:
        """Write a scan behind those that are kept; its row."""
        bearings, row = bearings_of(scan), self.count
        rows, beams = self.returns.points.shape[:2]
        if row == rows or bearings.beams > beams:
            rows *= 1 + (row == rows)
            self.returns = _grown(self.returns, rows, max(beams, bearings.beams))
            self.centres = np.concatenate([self.centres, np.zeros((rows - len(self.centres), 3))])
        limit = min(self._max_range_m, scan.max_range)
        _write(self.returns, row, bearings, scan.ranges, scan.bearings, limit)
        return row

    def keep(self) -> int:
        """Keep the newest scan; its row."""
        points = self.returns.points[self.count]
        self.centres[self.count, :2] = points[:, :2].sum(axis=0) / max(np.count_nonzero(points[:, 2]), 1)
        self.count += 1
        return self.count - 1


def _zeros(rows: int, beams: int) -> Returns:
    shape = (rows, beams, 3)
    return Returns(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((rows, len(Bearings._fields))))


def _grown(returns: Returns, rows: int, beams: int) -> Returns:
    """The same returns in larger arrays."""
    out, (n, m) = _zeros(rows, beams), returns.points.shape[:2]
    out.points[:n, :m], out.normals[:n, :m], out.cells[:n] = returns
    return out
