"""Scans with normals, in arrays that grow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.laser import Scan
from sixthsense.slam.scans.bearings import Bearings, bearings_of, fill_cells
from sixthsense.slam.scans.normals import fit_normals


class Returns(NamedTuple):
    """Returns of scans, by scan and by bearing; laser's frame, m."""

    points: NDArray[np.float32]
    """(n, beams, 3) x, y and range; range 0 where there is no return"""
    normals: NDArray[np.float32]
    """(n, beams, 3) normal towards the laser and variance of its angle, rad^2; (0, 0, 0) where there is none"""
    bearings: Bearings
    """the cells of all scans"""


class ScanStore:
    """Keyframes, one row each; the row after the last one holds the newest scan until it is kept or replaced."""

    def __init__(self, max_range_m: float, bearings: Bearings | None = None) -> None:
        """Begin empty; returns beyond `max_range_m` are not used. Without `bearings`, those of the first scan."""
        self._max_range_m = max_range_m
        self._returns = None if bearings is None else _empty(bearings)
        self.count = 0
        """number of scans kept"""

    @property
    def returns(self) -> Returns:
        """The arrays, with `count` scans, then the newest one, then rows without meaning."""
        assert self._returns is not None
        return self._returns

    def put(self, scan: Scan) -> int:
        """Write a scan behind those that are kept; its row."""
        if self._returns is None:
            self._returns = _empty(bearings_of(scan))
        elif self.count == len(self._returns.points):
            points, normals = (
                np.concatenate([rows, np.zeros_like(rows)]) for rows in (self._returns.points, self._returns.normals)
            )
            self._returns = Returns(points, normals, self._returns.bearings)
        points, normals, bearings = self._returns
        limit = min(self._max_range_m, scan.max_range)
        fill_cells(scan.ranges, scan.bearings, bearings, limit, points[self.count])
        fit_normals(points[self.count], bearings, normals[self.count])
        return self.count

    def keep(self) -> int:
        """Keep the newest scan; its row."""
        self.count += 1
        return self.count - 1


def _empty(bearings: Bearings) -> Returns:
    shape = (64, bearings.beams, 3)
    return Returns(np.zeros(shape, np.float32), np.zeros(shape, np.float32), bearings)
