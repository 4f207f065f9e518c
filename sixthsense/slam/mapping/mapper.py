"""The grid with the key scans behind it: it is rebuilt when a smoother has moved their poses."""

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
        """number of times the grid was rebuilt"""
        self._tolerance_m = 0.5 * config.cell_m
        self._scans: list[tuple[Scan, Array]] = []
        self._mean_ranges = np.zeros(0)
        """(K,) mean range of each scan, m: the lever of its heading"""
        self._added_at = np.zeros((0, 3))
        """(K, 3) pose at which each scan was added to the grid"""

    def add(self, trajectory: Array, scan: Scan, walls_robot: Array) -> None:
        """Add the newest key scan, with the walls (W, 2, 2) fitted to it, at the last row of `trajectory` (K, 3).

        The rows before are the present estimates of the earlier key scans' poses.
        """
        self._scans.append((scan, walls_robot))
        returned = scan.ranges[scan.ranges < scan.max_range]
        self._mean_ranges = np.append(self._mean_ranges, returned.mean() if len(returned) else 0.0)
        if self._has_moved(trajectory[:-1]):
            self.grid.clear()
            self.rebuilds += 1
            for (old, walls), row in zip(self._scans, trajectory, strict=True):
                self.grid.add(Pose.from_array(row), old, walls)
            self._added_at = trajectory.copy()
        else:
            self.grid.add(Pose.from_array(trajectory[-1]), scan, walls_robot)
            self._added_at = np.vstack([self._added_at, trajectory[-1:]])

    def _has_moved(self, trajectory: Array) -> bool:
        if len(trajectory) == 0:
            return False
        shift = trajectory - self._added_at
        displacement = np.hypot(shift[:, 0], shift[:, 1]) + np.abs(wrap_angle(shift[:, 2])) * self._mean_ranges[:-1]
        return bool(displacement.max() > self._tolerance_m)
