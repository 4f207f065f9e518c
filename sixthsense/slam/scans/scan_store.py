"""Scans with normals, in arrays that grow."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.slam.scans.bearings import Bearings, bearings_of, fill_cells
from sixthsense.slam.scans.normals import fit_normals

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


class ScanStore:
    """Keyframes, one row each; the row after the last one holds the newest scan until it is kept or replaced."""

    def __init__(self, max_range_m: float, bearings: Bearings | None = None) -> None:
        """Begin empty; returns beyond `max_range_m` are not used. Without `bearings` each scan has its own."""
        self._max_range_m, self._bearings = max_range_m, bearings
        self._returns = _zeros(_ROWS, 0 if bearings is None else bearings.beams)
        self.count = 0
        """number of scans kept"""

    @property
    def returns(self) -> Returns:
        """The arrays, with `count` scans, then the newest one, then rows without meaning."""
        return self._returns

    def put(self, scan: Scan) -> int:
        """Write a scan behind those that are kept; its row."""
        bearings = self._bearings or bearings_of(scan)
        rows, beams = self._returns.points.shape[:2]
        if self.count == rows or bearings.beams > beams:
            self._returns = _grown(self._returns, rows * (1 + (self.count == rows)), max(beams, bearings.beams))
        points, normals, cells = self._returns
        limit, cells[self.count] = min(self._max_range_m, scan.max_range), bearings
        fill_cells(scan.ranges, scan.bearings, bearings, limit, points[self.count])
        fit_normals(points[self.count], bearings, normals[self.count])
        return self.count

    def keep(self) -> int:
        """Keep the newest scan; its row."""
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
