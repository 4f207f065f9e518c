"""The store of scans: their returns by bearing, with normals, a row of arrays for each scan."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.core.returns import Bearings


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

    def __init__(self, max_range_m: float) -> None:
        """Begin empty; returns beyond `max_range_m` are not used."""
        self._max_range_m = max_range_m
        self.returns = _zeros(1, 0)
        """the arrays, with `count` scans, then the newest one, then rows without meaning"""
        self.centres = np.zeros((1, 3))
        """(n, 3) middle of what each scan sees, in its frame, as a pose without a turn"""
        self.count = 0
        """number of scans kept"""

    def put(self, scan: Scan) -> int:
        """Write a scan behind those that are kept; its row."""
        seen, row = scan.by_bearing, self.count
        rows, beams = self.returns.points.shape[:2]
        if row == rows or len(seen) > beams:
            rows *= 1 + (row == rows)
            self.returns = _grown(self.returns, rows, max(beams, len(seen)))
            self.centres = np.concatenate([self.centres, np.zeros((rows - len(self.centres), 3))])
        is_near = (seen[:, 2:] > 0.0) & (seen[:, 2:] < self._max_range_m)
        for out, values in zip(self.returns[:2], (seen, scan.normals), strict=True):
            out[row, len(seen) :] = 0.0
            np.multiply(values, is_near, out=out[row, : len(seen)])
        self.returns.cells[row] = scan.cells
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
