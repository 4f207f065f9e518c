"""What views are chosen from: the map at one moment, what is to be seen of it, and where the robot can drive.

Masks are (H, W), indexed [row = y, col = x]. All of it is computed when a view is chosen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.frontier import PIECE_M, Known, Piece, Region, cells_within, frontier_pieces
from sixthsense.navigation.gridsearch import Cell, Cells, Links, ways_from
from sixthsense.navigation.path_planner import DrivingMap
from sixthsense.navigation.visibility import nearest_view, visible_cells
from sixthsense.slam.mapping.freespace import Bools, Floats

TILE_M = 0.2
"""side of the tiles by which ways are measured, unless the robot is narrower: no way leads through a wall"""
LEAST_AREA_M2, LEAST_SHARE = 0.5, 0.002
"""a view is worth its way if it shows so much of what is unseen, or such a share of the seen part of the region"""


class ViewMap:
    """The map at one choice of a view. Cells of a tile are those of a square of `side` cells."""

    def __init__(
        self, map_: DrivingMap, pose: Pose, region: Region, outside_m: float, radius_m: float, given_up: Bools
    ) -> None:
        """The map of a disc of `radius_m` at a pose, that is to see a region and what is near it.

        `given_up` (H, W), of the cells of the clearance, are no longer to be seen.
        """
        clearance = map_.clearance
        self.cell_m, self._radius_m = clearance.cell_m, radius_m
        self.side = max(1, min(round(TILE_M / self.cell_m), math.floor(clearance.least_m / self.cell_m)))
        """cells of a tile's side"""
        space = map_.free_space(pose)
        wanted = cells_within(region, self.cell_m, outside_m).within(clearance.box[:2], clearance.seen.shape)
        rim = max(3, math.ceil(radius_m / self.cell_m))  # what a frontier is beside, and where the robot may pass
        known, here = clearance.seen | clearance.obstacles, clearance.cell(pose.position)
        parts = _parts(known, here, wanted, self.side, rim)
        self.first: Cell = (clearance.box.top + parts[0].start, clearance.box.left + parts[1].start)
        """row and col of the masks' corner, counted from the world's origin"""
        self.metres = clearance.metres[parts]
        self.seen, self.obstacles = space.seen[parts], clearance.obstacles[parts]
        seen = np.count_nonzero(self.seen[cells_within(region, self.cell_m, 0.0).within(self.first, self.seen.shape)])
        self.least_m2 = min(LEAST_AREA_M2, LEAST_SHARE * seen * self.cell_m**2)
        """unseen area that a view has to show to be worth its way"""
        self.free: Bools = self.seen & ~self.obstacles
        """(H, W) seen, and no obstacle"""
        self.known = Known.of(self.seen, self.obstacles, self.first, self.cell_m, region, outside_m)
        """what is known, and what is to be seen, given up or not"""
        self.wanted: Bools = self.known.unseen & ~given_up[parts]
        """(H, W) to be seen"""
        self.passable: Bools = self.seen & ~space.blocked[parts]
        """(H, W) where the robot may drive"""
        self.here = self.cell(pose.position)
        """the robot's cell"""
        if not self.seen[self.here]:  # of a robot whose laser is ahead of it
            beside = tuple(slice(max(k - rim, 0), k + rim + 1) for k in self.here)
            self.passable[beside] |= ~space.blocked[parts][beside]
        self.links = Links.of(self.passable, self.side)
        self.ways, _ = ways_from(self.links, self.tile_cost(1.0), self.tile(self.here), np.zeros((0, 2), np.int64))
        """(R, C) lengths of ways from the robot to tiles, in tiles; inf where none leads"""
        # Cells on both sides of a closed gap may meet in a tile. A path steps across edges of cells, seen or not.
        areas, _ = ndimage.label(~space.blocked[parts])
        has_way = np.isfinite(self.ways).repeat(self.side, axis=0).repeat(self.side, axis=1)
        self.reachable: Bools = self.passable & has_way & (areas == areas[self.here])
        """(H, W) cells that the robot can drive to"""
        self.places = self.best_cells(self.reachable)
        """(R, C) of each tile that the robot can drive to its cell with the most clearance, a flat index; else -1"""

    def cell(self, point_world: Array) -> Cell:
        """Row and col of a (2,) point, clipped to the masks."""
        x, y = np.asarray(point_world, dtype=np.float64).tolist()
        row, col = math.floor(y / self.cell_m) - self.first[0], math.floor(x / self.cell_m) - self.first[1]
        return min(max(row, 0), self.seen.shape[0] - 1), min(max(col, 0), self.seen.shape[1] - 1)

    def points(self, cells: Cells) -> Array:
        """(N, 2) centres of cells (N, 2), world frame, metres."""
        return np.asarray((np.asarray(cells, dtype=np.float64) + self.first + 0.5)[:, ::-1] * self.cell_m)

    def tile(self, cell: Cell) -> Cell:
        """The tile of a cell."""
        return cell[0] // self.side, cell[1] // self.side

    def tile_cost(self, value: float) -> Floats:
        """(R, C) the same cost of all tiles."""
        return np.full(self.links.right.shape, value, dtype=np.float32)

    def best_cells(self, mask: Bools) -> NDArray[np.int64]:
        """(R, C) of each tile its cell of `mask` with the most clearance, a flat index; -1 without one."""
        rows, cols = self.links.right.shape
        best, most = np.full((rows, cols), -1), np.full((rows, cols), -1.0, dtype=np.float32)
        index = np.arange(mask.size).reshape(mask.shape)
        for row, col in np.ndindex(self.side, self.side):
            part = slice(row, None, self.side), slice(col, None, self.side)
            is_better = mask[part] & (self.metres[part] > most)
            np.copyto(best, index[part], where=is_better)
            np.copyto(most, self.metres[part], where=is_better)
        return best

    def lengths_m(self, cells: Cells) -> Array:
        """(N,) lengths of the ways from the robot to cells (N, 2), metres; inf where none leads."""
        tiles = np.asarray(cells).reshape(-1, 2) // self.side
        return np.asarray(self.ways[tuple(tiles.T)] * self.side * self.cell_m, dtype=np.float64)

    def pieces(self, unseen: Bools) -> list[Piece]:
        """The pieces of the frontier beside `unseen` (H, W) that are worth a look."""
        robot = self.here, self._radius_m
        return frontier_pieces(self.known.free, unseen, self.first, self.cell_m, robot)

    def view_of(self, piece: Piece, places: NDArray[np.int64], reach: float) -> Cell | None:
        """The nearest of the `places` (R, C), which `best_cells` returns, that has a piece in view within a reach."""
        index = int(nearest_view(self.obstacles, places, self.side, *piece.centre, reach))
        return divmod(index, self.seen.shape[1]) if index >= 0 else None

    def shows_enough(self, viewpoint: Cell, piece: Piece, unseen: Bools) -> bool:
        """Whether much of what is `unseen` (H, W) is in view, in a circle that reaches `PIECE_M` beyond the piece.

        Most frontiers that show little are holes that beams left in walls.
        """
        depth = math.dist(viewpoint, piece.centre) + PIECE_M / self.cell_m
        shown = visible_cells(self.obstacles, unseen, *viewpoint, depth)
        return len(shown) * self.cell_m**2 >= self.least_m2


def _parts(known: Bools, here: Cell, wanted: tuple[slice, slice], side: int, rim: int) -> tuple[slice, slice]:
    """The rows and columns of what is known (H, W), with a rim of unknown cells, of `here`, and of what is wanted.

    They are of whole tiles of `side` cells.
    """
    found = []
    for axis, span in enumerate(wanted):
        cells = [*np.flatnonzero(known.any(axis=1 - axis)).tolist(), here[axis], span.start, span.stop]
        low, high = max(min(cells) - rim, 0), max(cells) + 1 + rim
        found.append(slice(low // side * side, min(-(-high // side), known.shape[axis] // side) * side))
    return found[0], found[1]
