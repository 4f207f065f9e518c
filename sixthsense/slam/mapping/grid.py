"""The hit grid and the sense grid (report sections 4.4 and 4.5): evidence per cell.

Cells are aligned to multiples of `cell_m` in the world, and indexed [row = y, col = x].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import TILE, Box, Changes, box_of, cell_box, grown_box
from sixthsense.slam.mapping.evidence import (
    OFFSET,
    SCANS_PER_STAMP,
    EvidenceRules,
    Field,
    Ints,
    ScanCells,
    Tiles,
    count_scan,
)
from sixthsense.slam.mapping.freespace import TOUCH, Bools, FreeSpace
from sixthsense.slam.mapping.submap import Submap, add_submap

_MOST_CELLS = 1000
"""of a robot's radius and clearance; a larger disc takes longer to draw than a robot takes to drive"""


class Walls(NamedTuple):
    """Segments (n, 2, 2) where a scan shows walls, also between its returns; robot frame, metres."""

    fitted: Array
    """to returns"""
    gaps: Array
    """between two returns; they close no cell that beams have shown to be free, such as a door's"""


NO_WALLS = Walls(*np.zeros((2, 0, 2, 2)))


class Grid:
    """Hit grid and sense grid in one: counts hits and passes per cell, and grows as the robot sees more.

    Evidence is counted once per scan: a scan adds at most one hit and one pass to a cell, and a hit takes precedence,
    so that beams grazing along a wall do not erase it. A cell is an obstacle when it has at least `min_hits` hits and
    at most `passes_per_hit` passes per hit, so that a stray return does not block for ever. A hit makes an obstacle at
    once, however long the cell has been free: earlier passes are cut to the most that still leave it an obstacle.
    Hits beyond `max_hits` are not counted, so that a wall that was drawn in the wrong place can be erased.
    """

    def __init__(self, config: GridConfig, radius_m: float) -> None:
        """Make an empty grid for a robot that is a disc of `radius_m`."""
        self.inflation_m = radius_m + config.clearance_m
        """the robot's radius and clearance"""
        if self.inflation_m > _MOST_CELLS * config.cell_m:
            found = f"found a radius and a clearance of {self.inflation_m / config.cell_m:.0f} cells"
            raise InputError("grid", found, f"at most {_MOST_CELLS}")
        self._config, self._rules = config, EvidenceRules.of(config)
        self.changes = Changes()
        """where the evidence, or who stands in the way, has changed"""
        self.clear()

    @classmethod
    def from_counts(
        cls, config: GridConfig, radius_m: float, origin: tuple[float, float], hits: Ints, passes: Ints, seen: Bools
    ) -> Grid:
        """The grid that has these counts: `hits`, `passes`, `seen` and `origin` of another one.

        Scans may be added to it as to the other one.
        """
        grid, (x, y) = cls(config, radius_m), origin
        row, col = round(y / config.cell_m), round(x / config.cell_m)
        kept = np.nonzero((hits > 0) | (passes > 0) | seen)
        cells = np.stack(kept, axis=1) + np.array([row, col])
        grid.compose([Submap(cells, hits[kept], passes[kept], seen[kept], np.zeros((len(cells), 3), dtype=np.int16))])
        grid._box = Box(row, col, row + hits.shape[0], col + hits.shape[1])
        return grid

    def clear(self) -> None:
        """Remove all evidence and all bodies, to rebuild the grid from stored scans."""
        self.changes.add_all()
        self._box, self._scans, self._tiles = Box(0, 0, 0, 0), 0, Tiles(self._rules)
        self._bodies: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
        """(N, 2) cells, row, col from the world's origin, of who stands in the way"""

    def add(self, T_world_robot: Pose, scan: Scan, walls: Walls = NO_WALLS) -> Box:
        """Count one scan taken at `T_world_robot`, and the walls that it shows.

        Returns the box of the cells that may have changed.

        A beam with a return hits the cell of its end and passes those before it. A beam without one (at or beyond
        the scan's maximum) passes all cells up to the maximum, or none if so configured. A NaN, zero or negative range
        is no evidence. Raises ValueError for a pose, walls or a range that are not finite,
        and when the grid would grow beyond 100 million cells; the grid is then unchanged.
        """
        T_world_laser = T_world_robot @ scan.T_robot_laser
        valid = scan.is_return | (self._config.no_return_passes & (scan.ranges > 0.0))
        returned = scan.is_return[valid]
        reach = np.minimum(scan.ranges[valid].astype(np.float64), scan.max_range)
        angles = scan.bearings[valid] + T_world_laser.theta
        ends = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1) + T_world_laser.position
        lines = (T_world_robot @ np.concatenate(walls)).reshape(-1, 2) if self._config.walls else np.empty((0, 2))
        points = np.concatenate([T_world_laser.position[None], ends, lines])[:, ::-1] / self._config.cell_m
        if not np.isfinite(points).all():
            raise ValueError("scan: found a pose, a wall or a range that is not finite, allowed: finite numbers")
        before, cells = self._box, np.floor(points)
        self._grow(box_of(cells))
        box = box_of(cells.astype(np.int64))
        tiles, n = self._tiles, 1 + len(ends)
        local, exact = cells.astype(np.int64) - tiles.first, points - tiles.first - 0.5
        touched = ScanCells(local[0], local[1:n], returned, local[n:], len(walls.fitted), exact[1:n])
        try:
            tiles.allocate(tiles.touched_by([box]))
        except InputError:
            self._box = before
            raise
        self.changes.add(box)
        if self._scans == SCANS_PER_STAMP:
            tiles.cells.stamp[:], self._scans = 0, 0
        self._scans += 1
        count_scan(tiles.cells, tiles.index, touched, self._scans, self._rules)
        return box

    def submap(self) -> Submap:
        """The evidence of this grid, to compose another one."""
        return Submap.of(self._tiles)

    def compose(self, submaps: Sequence[Submap]) -> None:
        """Replace all evidence by that of submaps in the order of their scans."""
        self.clear()
        boxes = [submap.box for submap in submaps if len(submap.cells)]
        if boxes:
            self.recompose(submaps, boxes)

    def recompose(self, submaps: Sequence[Submap], boxes: Sequence[Box]) -> None:
        """Replace the evidence in the tiles that boxes touch by that of submaps in the order of their scans."""
        for box in boxes:
            self._grow(box)
        tiles = self._tiles
        touched = tiles.touched_by(boxes)
        tiles.erase(touched)
        for whole in submaps:
            submap = whole.within(touched, tiles.first)
            slots = tiles.slots(submap.cells)
            add_submap(tiles.cells, slots, submap, self._rules)
        tiles.mark_obstacles(touched)
        for box in boxes:
            self.changes.add(box.aligned(TILE))

    def mark_seen(self, cells: NDArray[np.int64]) -> None:
        """Mark cells (N, 2), row, col from the world's origin, as seen."""
        if len(cells):
            self._grow(box_of(cells))
            self.changes.add_all()
            slots = self._tiles.slots(cells)
            self._tiles.cells.seen[slots] = True

    def block_bodies(self, T_world_robot: Pose, standing_robot: Array, body_m: float) -> None:
        """Block the ways through bodies of a radius about returns (M, 2), robot's frame, in place of earlier ones.

        They are kept clear of as obstacles are, and are none: they are no evidence.
        """
        before, around = self._bodies, disc(body_m / self._config.cell_m)
        at = np.floor((T_world_robot @ standing_robot)[:, ::-1] / self._config.cell_m).astype(np.int64)
        self._bodies = np.unique((at[:, None] + around).reshape(-1, 2), axis=0)
        for bodies in (before, self._bodies):
            if len(bodies):
                self._grow(box_of(bodies))
                self.changes.add(box_of(bodies))

    def free_space(self, *points_world: ArrayLike) -> FreeSpace:
        """Cells whose centres keep radius and clearance from those of obstacles; (2,) points are covered."""
        taken = self.obstacles
        taken[tuple((self._bodies - self._box[:2]).T)] = True
        metres = ndimage.distance_transform_edt(~taken) * self._config.cell_m if taken.any() else np.inf
        free = np.broadcast_to(metres > self.inflation_m, taken.shape)
        return FreeSpace(~free, self.seen, self.origin, self._config.cell_m).covering(*points_world)

    def obstacle_points(self, box: Box) -> Array:
        """(N, 2) where the obstacles in a box are, world frame, metres: the mean of each cell's returns."""
        cells, kept = np.argwhere(self.part("obstacles", box)) + box[:2], self._tiles.cells
        slots = self._tiles.slots(cells)
        points = cells[:, ::-1] + 0.5 + np.stack([kept.across[slots], kept.down[slots]], axis=1) / OFFSET
        inside = ((self._bodies >= box[:2]) & (self._bodies < box[2:])).all(axis=1)
        points = np.concatenate([points, self._bodies[inside][:, ::-1] + 0.5])
        return np.asarray(points * self._config.cell_m)

    def part(self, name: Field, box: Box) -> NDArray[Any]:
        """(H, W) what is kept of the cells in a box, 0 or False outside the grid."""
        return self._tiles.part(getattr(self._tiles.cells, name), box)

    @property
    def hits(self) -> Ints:
        """(H, W) scans that ended, or had a wall fitted, in the cell."""
        return self._whole("hits").astype(np.int32)

    @property
    def passes(self) -> Ints:
        """(H, W) scans that crossed the cell and did not hit it."""
        return self._whole("passes")

    @property
    def seen(self) -> Bools:
        """(H, W) whether a beam has ever crossed the cell or ended in it: the sense grid, report section 4.5."""
        return self._whole("seen")

    @property
    def seen_area_m2(self) -> float:
        """Area of the cells that are seen."""
        return int(np.count_nonzero(self._tiles.cells.seen)) * self._config.cell_m**2

    @property
    def obstacles(self) -> Bools:
        """(H, W) cells whose evidence says occupied; not inflated."""
        return self._whole("obstacles")

    @property
    def box(self) -> Box:
        """The box of all cells that were seen, with the robot's radius and a rim, from the world's origin; it grows."""
        return self._box

    @property
    def origin(self) -> tuple[float, float]:
        """World x, y of the lower left corner of cell (0, 0), metres; it moves when the grid grows."""
        return self._box.left * self._config.cell_m, self._box.top * self._config.cell_m

    def occupancy(self) -> NDArray[np.int8]:
        """(H, W) as a map server has it: 0 seen and free, 100 obstacle, -1 unknown."""
        free, obstacle, unknown = np.array([0, 100, -1], dtype=np.int8)
        return np.asarray(np.where(self.obstacles, obstacle, np.where(self.seen, free, unknown)))

    def _whole(self, name: Field) -> NDArray[Any]:
        """(H, W) what is kept of all cells; InputError if they are more than 100 million."""
        box = np.array(self._box, dtype=np.float64)
        cell_box(box[:2], box[2:])
        return self.part(name, self._box)

    def _grow(self, box: Box) -> None:
        """Make room for the cells of a box, for the robot around them, and for a rim."""
        margin = 1.0 + math.floor(self.inflation_m / self._config.cell_m + 0.5 + TOUCH)
        low, high = np.array(box[:2], dtype=np.float64), np.array(box[2:], dtype=np.float64)
        self._box = grown_box(self._box, low - margin, high + margin)
        self._tiles.cover(self._box)


def disc(radius: float) -> NDArray[np.int64]:
    """(K, 2) offsets (row, col) of the cells about whose centres a disc, in cells, touches the square at (0, 0)."""
    reach = math.floor(radius + 0.5 + TOUCH)
    gap = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0.0)
    return np.argwhere(np.hypot(gap[:, None], gap[None, :]) <= radius + TOUCH) - reach
