"""The map of the keyframes at their present poses, in submaps."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import TILE, Box, box_of
from sixthsense.slam.mapping.evidence import EvidenceRules
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.grid import NO_WALLS, Grid, Walls, disc
from sixthsense.slam.mapping.submap import Submap

_NOTHING = np.zeros((0, 2))
BODY_M = 0.2
"""kept from what moves besides: the laser sees legs, and a body is wider"""
SCANS_PER_SUBMAP = 10
"""Keyframes of a submap, some metres of travel: as many as the grid redraws where one of them has moved."""


class Additions(NamedTuple):
    """What a mapper was given since a number of keyframes: another one that takes it draws the same map."""

    scans: list[tuple[int, Scan, Walls]]
    """as `add` has them: row in the trajectory, scan, walls"""
    trajectory: Array
    """(K, 3) present poses of all keyframes"""
    standing_robot: Array
    """(M, 2) returns of who stands in the newest keyframe"""


class Mapper:
    """Keeps keyframes, and draws them into its grid when it is told to, as before a navigator looks at the map.

    A keyframe that nobody looks at costs nothing until the end. When a keyframe that is drawn has moved by half a cell,
    its submap is drawn again, and the tiles that it touches are composed of all submaps that touch them.
    """

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Begin with an empty grid for a robot that is a disc of `radius_m`."""
        self.grid = Grid(config, radius_m)
        """the map as it was drawn last"""
        self._config, self._radius_m = config, radius_m
        self._scans: list[tuple[Scan, Walls]] = []
        self._mean_ranges: list[float] = []
        """mean range of each scan, m: the lever of its heading"""
        self._trajectory: Callable[[], Array] = lambda: np.zeros((0, 3))
        """returns (K, 3) present poses of all keyframes"""
        self._rows: list[int] = []
        """of each scan among them: a keyframe of named observations has no scan"""
        self._submaps: dict[int, Submap] = {}
        """of `SCANS_PER_SUBMAP` scans each, by number; drawn when scans begin to move"""
        self._boxes: list[Box] = []
        """of the cells that each scan which is in the grid may have changed"""
        self._drawn_at = np.zeros((0, 3))
        """(D, 3) pose at which each scan that is in the grid was drawn"""
        self._standing_robot = _NOTHING
        self.earlier: Submap | None = None
        """evidence of an earlier run"""
        self._base: list[Submap] = []
        """evidence before that of the first scan: the earlier run's as that of a few scans"""

    def start_from(self, evidence: Submap) -> None:
        """Begin with the evidence of an earlier run, as that of a few scans.

        Its cells count as seen when this run has seen them, or when the map is complete: exploring sees all of the
        building again.
        """
        self.earlier, self._base = evidence, [evidence.weakened(EvidenceRules.of(self._config))]
        self.grid.compose(self._base)

    def add(
        self,
        index: int,
        trajectory: Callable[[], Array],
        scan: Scan,
        walls: Walls = NO_WALLS,
        standing_robot: Array = _NOTHING,
    ) -> None:
        """Take the newest keyframe, with the walls that it shows and the returns (M, 2) of who stands in it.

        `index` is its row in what `trajectory` returns, the present estimates (K, 3) of all keyframes' poses, which is
        called when the map is drawn.
        """
        self._standing_robot = standing_robot
        self._rows.append(index)
        self._scans.append((scan, walls))
        returned = scan.ranges[scan.is_return]
        self._mean_ranges.append(float(returned.mean()) if len(returned) else 0.0)
        self._trajectory = trajectory

    def additions(self, since: int) -> Additions:
        """What was added since there were so many keyframes."""
        added = [(row, *each) for row, each in zip(self._rows[since:], self._scans[since:], strict=True)]
        return Additions(added, self._trajectory(), self._standing_robot)

    def take(self, additions: Additions) -> None:
        """Add what another mapper was given."""
        for row, scan, walls in additions.scans:
            self.add(row, lambda: additions.trajectory, scan, walls, additions.standing_robot)

    def are_free(self, points: Array, within_m: float) -> Bools:
        """(N,) whether the cells within a distance and a cell of points (N, 2), world frame, are seen and free."""
        grid, cell_m = self.draw(), self._config.cell_m
        around = np.floor(points / cell_m).astype(np.int64)[:, None, ::-1] + disc(within_m / cell_m + 1.0)[None]
        box = box_of(around.reshape(-1, 2))
        is_free = grid.part("seen", box) & ~grid.part("obstacles", box)
        return np.asarray(is_free[around[..., 0] - box.top, around[..., 1] - box.left].all(axis=1))

    def complete(self, trajectory: Array) -> None:
        """Draw the map for the last time, at the final poses (K, 3) whoever read it before, and let the scans go."""
        final, self._rows = trajectory[self._rows], list(range(len(self._rows)))
        self._trajectory = lambda: final
        if not np.array_equal(self._drawn_at, final[: len(self._drawn_at)]):
            self.grid.compose(self._base)
            self._drawn_at, self._boxes = np.zeros((0, 3)), []
            self._submaps = {}
        self.draw()
        self.grid.block_bodies(Pose(), _NOTHING, BODY_M)
        if self.earlier is not None:
            self.grid.mark_seen(self.earlier.cells[self.earlier.seen])
        self._scans, self._mean_ranges, self._submaps = [], [], {}

    def draw(self) -> Grid:
        """Draw the scans that are due, compose anew what those have changed that are drawn and have moved; the grid."""
        drawn = len(self._drawn_at)
        if drawn == len(self._rows):
            return self.grid
        poses = self._trajectory()[self._rows]
        moved = self._shift(poses[:drawn]) > 0.5 * self._config.cell_m
        if moved.any():
            self._redraw(moved, poses)
        for k in range(drawn, len(poses)):
            self._boxes.append(self._add(self.grid, k, poses))
        self._drawn_at = np.vstack([self._drawn_at, poses[drawn:]])
        self.grid.block_bodies(Pose.from_array(poses[-1]), self._standing_robot, BODY_M)
        return self.grid

    def _shift(self, poses: Array) -> Array:
        """(D,) by how much each scan that is drawn shows its surroundings elsewhere from its present pose (D, 3), m."""
        shift = poses - self._drawn_at
        turned_m = np.abs(wrap_angle(shift[:, 2])) * np.array(self._mean_ranges[: len(poses)])
        return np.asarray(np.hypot(shift[:, 0], shift[:, 1]) + turned_m)

    def _redraw(self, moved: Bools, poses: Array) -> None:
        """Draw submaps with a moved scan again, and compose the tiles that these touch, or touched, of all submaps.

        The scans after the last whole submap are drawn again, too.
        """
        count = len(moved) // SCANS_PER_SUBMAP
        rest = range(count * SCANS_PER_SUBMAP, len(moved))
        boxes = [self._boxes[k] for k in rest]
        for m in np.unique(np.flatnonzero(moved[: rest.start]) // SCANS_PER_SUBMAP).tolist():
            scans = _scans_of(m)
            boxes += self._boxes[scans]
            self._drawn_at[scans] = poses[scans]
            self._submaps[m] = self._drawn(m)
            boxes += self._boxes[scans]
        near = [m for m in range(count) if _meet(self._boxes[_scans_of(m)], boxes)]
        for m in near:
            if m not in self._submaps:
                self._submaps[m] = self._drawn(m)
        self.grid.recompose([*self._base, *(self._submaps[m] for m in near)], boxes)
        for k in rest:
            self._boxes[k] = self._add(self.grid, k, poses)
            self._drawn_at[k] = poses[k]

    def _drawn(self, m: int) -> Submap:
        """A submap of scans where they are drawn."""
        own, scans = Grid(self._config, self._radius_m), _scans_of(m)
        self._boxes[scans] = [self._add(own, k, self._drawn_at) for k in range(scans.start, scans.stop)]
        return own.submap()

    def _add(self, grid: Grid, k: int, poses: Array) -> Box:
        """Add a scan to a grid at its row of `poses` (K, 3); the box of the cells that it may have changed."""
        scan, walls = self._scans[k]
        return grid.add(Pose(*poses[k].tolist()), scan, walls)


def _scans_of(m: int) -> slice:
    """The scans of a submap."""
    return slice(m * SCANS_PER_SUBMAP, (m + 1) * SCANS_PER_SUBMAP)


def _meet(some: list[Box], others: list[Box]) -> bool:
    """Whether the tiles of any of the boxes may be those of any of the others."""
    a, b = (np.array([box.aligned(TILE) for box in boxes]) for boxes in (some, others))
    low, high = np.maximum(a[:, None, :2], b[None, :, :2]), np.minimum(a[:, None, 2:], b[None, :, 2:])
    return bool((low < high).all(axis=2).any())
