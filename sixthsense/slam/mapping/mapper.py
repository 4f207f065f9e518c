"""The map of the key scans at their present poses, in submaps, drawn when someone reads it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.evidence import Cells, EvidenceRules
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.submap import Submap, weakened

SCANS_PER_SUBMAP = 10
"""Key scans of a submap, some metres of travel: as many as the grid redraws where one of them has moved."""


class DrawnGrid(Grid):
    """A grid that is brought up to date when it is read."""

    def __init__(self, config: GridConfig, radius_m: float, draw: Callable[[], None]) -> None:
        """Make an empty grid; `draw` adds to it what is due."""
        super().__init__(config, radius_m)
        self._draw: Callable[[], None] | None = draw

    def _counted(self) -> Cells:
        if self._draw is not None:
            self._draw()
        return self._cells

    def complete(self) -> None:
        """Draw what is due for the last time."""
        self._counted()
        self._draw = None


class Mapper:
    """Keeps key scans, and draws them into a grid when it is read.

    A key scan that nobody looks at costs nothing. Where the grid was read since the last key scan, as a navigator
    reads it, the next one is drawn at once. When a key scan that is drawn has moved by half a cell, its submap is drawn
    again, and the grid is composed of the submaps.
    """

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Begin with an empty grid for a robot that is a disc of `radius_m`."""
        self.grid = DrawnGrid(config, radius_m, self._read)
        self.rebuilds = 0
        """number of times the grid was drawn again"""
        self._config, self._radius_m = config, radius_m
        self._tolerance_m = 0.5 * config.cell_m
        self._is_read = False
        self._scans: list[tuple[Scan, Array]] = []
        self._mean_ranges: list[float] = []
        """mean range of each scan, m: the lever of its heading"""
        self._trajectory: Callable[[], Array] = lambda: np.zeros((0, 3))
        """returns (K, 3) present poses, the first ones those of the scans"""
        self._submaps: list[Submap] = []
        """of `SCANS_PER_SUBMAP` scans each, from the first on; made when the grid is composed for the first time"""
        self._drawn_at = np.zeros((0, 3))
        """(D, 3) pose at which each scan that is in the grid was drawn"""
        self._earlier: Submap | None = None
        """evidence of an earlier run"""
        self._base: list[Submap] = []
        """evidence before that of the first scan: the earlier run's as that of a few scans"""

    def start_from(self, evidence: Submap) -> None:
        """Begin with the evidence of an earlier run, as that of a few scans.

        Its cells count as seen when this run has seen them, or when the map is complete: exploring sees all of the
        building again.
        """
        config = self._config
        rules = EvidenceRules(config.min_hits, config.max_hits, config.passes_per_hit)
        self._earlier, self._base = evidence, [weakened(evidence, rules)]
        self._clear()

    def add(self, trajectory: Callable[[], Array], scan: Scan, walls_robot: Array) -> None:
        """Take the newest key scan, with the walls (W, 2, 2) fitted to it.

        `trajectory` returns the present estimates (K, 3) of all key scans' poses; it is called when the map is drawn.
        """
        self._scans.append((scan, walls_robot))
        returned = scan.ranges[scan.ranges < scan.max_range]
        self._mean_ranges.append(float(returned.mean()) if len(returned) else 0.0)
        self._trajectory = trajectory
        if self._is_read:
            self._is_read = False
            self._draw()

    def complete(self, trajectory: Array) -> None:
        """Draw the map for the last time, at the final poses (K, 3) whoever read it before, and let the scans go."""
        final = trajectory[: len(self._scans)]
        self._trajectory = lambda: final
        if not np.array_equal(self._drawn_at, final[: len(self._drawn_at)]):
            self._clear()
            self.rebuilds += 1
            self._drawn_at = np.zeros((0, 3))
        self.grid.complete()
        if self._earlier is not None:
            self.grid.mark_seen(self._earlier.cells[self._earlier.seen])
        self._scans, self._mean_ranges, self._submaps = [], [], []

    def _clear(self) -> None:
        """Remove the evidence of all scans of this run."""
        self.grid.compose(self._base)

    def _read(self) -> None:
        self._is_read = True
        self._draw()

    def _draw(self) -> None:
        """Draw the scans that are due, and compose the grid anew if one that is drawn has moved."""
        drawn = len(self._drawn_at)
        if drawn == len(self._scans):
            return
        poses = self._trajectory()[: len(self._scans)]
        moved = self._moved(poses[:drawn])
        if moved.any():
            drawn = self._compose(moved, poses)
            self.rebuilds += 1
        self._add(self.grid, slice(drawn, None), poses)
        self._drawn_at = np.vstack([self._drawn_at[:drawn], poses[drawn:]])

    def _moved(self, poses: Array) -> Bools:
        """(D,) which of the scans that are drawn have moved by half a cell, to their present poses (D, 3)."""
        shift = poses - self._drawn_at
        lever_m = np.array(self._mean_ranges[: len(poses)])
        displacement = np.hypot(shift[:, 0], shift[:, 1]) + np.abs(wrap_angle(shift[:, 2])) * lever_m
        return np.asarray(displacement > self._tolerance_m)

    def _compose(self, moved: Bools, poses: Array) -> int:
        """Compose the grid of submaps, those with a moved scan drawn again; the number of scans that are in it."""
        count = len(moved) // SCANS_PER_SUBMAP
        for k in range(count):
            scans = slice(k * SCANS_PER_SUBMAP, (k + 1) * SCANS_PER_SUBMAP)
            if k == len(self._submaps) or moved[scans].any():
                own = Grid(self._config, self._radius_m)
                self._add(own, scans, poses)
                self._submaps[k : k + 1] = [own.submap()]
                self._drawn_at[scans] = poses[scans]
        self.grid.compose([*self._base, *self._submaps])
        return count * SCANS_PER_SUBMAP

    def _add(self, grid: Grid, scans: slice, poses: Array) -> None:
        """Add scans to a grid at their present poses, rows of `poses` (K, 3)."""
        for (scan, walls), row in zip(self._scans[scans], poses[scans], strict=True):
            grid.add(Pose.from_array(row), scan, walls)
