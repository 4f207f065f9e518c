"""The grid and the scans behind it: drawn as they come, and anew when a smoother has moved where they were taken."""

from __future__ import annotations

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.grid import Grid


class Mapper:
    """Adds key scans to a grid, keeps them, and rebuilds the grid when one of them has moved by half a cell."""

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Begin with an empty grid for a robot that is a disc of `radius_m`."""
        self.grid = Grid(config, radius_m)
        self.rebuilds = 0
        """how often the grid was drawn anew"""
        self._slack_m = 0.5 * config.cell_m
        self._scans: list[tuple[Scan, Array]] = []
        self._reach = np.zeros(0)
        """(K,) how far each scan sees on average, m: the lever of its heading"""
        self._drawn = np.zeros((0, 3))
        """(K, 3) where each scan is in the grid"""

    def add(self, trajectory: Array, scan: Scan, walls_robot: Array) -> None:
        """Add the newest key scan, with the walls (W, 2, 2) fitted to it, at the last row of `trajectory` (K, 3).

        The rows before are where the estimator now has the earlier key scans.
        """
        self._scans.append((scan, walls_robot))
        returned = scan.ranges[scan.ranges < scan.max_range]
        self._reach = np.append(self._reach, returned.mean() if len(returned) else 0.0)
        if self._has_moved(trajectory[:-1]):
            self.grid.clear()
            self.rebuilds += 1
            for (old, walls), row in zip(self._scans, trajectory, strict=True):
                self.grid.add(Pose.from_array(row), old, walls)
            self._drawn = trajectory.copy()
        else:
            self.grid.add(Pose.from_array(trajectory[-1]), scan, walls_robot)
            self._drawn = np.vstack([self._drawn, trajectory[-1:]])

    def _has_moved(self, trajectory: Array) -> bool:
        if len(trajectory) == 0:
            return False
        shift = trajectory - self._drawn
        way = np.hypot(shift[:, 0], shift[:, 1]) + np.abs(wrap_angle(shift[:, 2])) * self._reach[:-1]
        return bool(way.max() > self._slack_m)
