"""Frontiers: free cells that were seen, beside cells that were not (Yamauchi, CIRA 1997).

Masks are (H, W), indexed [row = y, col = x]; `first` is the row and col of their corner from the world's origin.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import Cell, Cells
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.freespace import TOUCH, Bools
from sixthsense.slam.mapping.grid import Grid

Region = tuple[float, float, float, float]
"""x0, y0, x1, y1, world frame, metres."""
PIECE_M = 1.0
"""longer frontiers are split"""
_AROUND = np.ones((3, 3), dtype=np.bool_)
_BESIDE = np.argwhere(ndimage.generate_binary_structure(2, 1)) - 1


class Piece(NamedTuple):
    """A piece of the border between free and unseen cells."""

    cells: Cells
    """(N, 2) free cells"""
    unseen: Cells
    """(M, 2) the unseen ones beside them"""

    @property
    def centre(self) -> Cell:
        """The unseen cell beside the free one that is nearest to their mean."""
        row, col = middle_cell(self.cells)
        row, col = self.unseen[int(np.argmin(np.abs(self.unseen - (row, col)).sum(axis=1)))].tolist()
        return row, col


def middle_cell(cells: Cells) -> Cell:
    """The one of (N, 2) cells that is nearest to their mean."""
    row, col = cells[int(np.argmin(((cells - cells.mean(axis=0)) ** 2).sum(axis=1)))].tolist()
    return row, col


class Known(NamedTuple):
    """What is known of a map, without what is narrower than three cells: holes in walls, and what beams leave out."""

    free: Bools
    """(H, W) known, and no obstacle"""
    unseen: Bools
    """(H, W) unseen areas of the region, with what continues them outside, as far as a margin, but for the smallest"""

    @classmethod
    def of(cls, seen: Bools, obstacles: Bools, first: Cell, cell_m: float, region: Region, outside_m: float) -> Known:
        """What is known of the seen cells and the obstacles (H, W)."""
        unknown = _opened(~(seen | obstacles))
        near = np.zeros_like(unknown)
        part = cells_within(region, cell_m, outside_m).within(first, near.shape)
        near[part] = unknown[part]
        areas, count = ndimage.label(near)
        is_inside = np.zeros(count + 1, dtype=np.bool_)
        inside = cells_within(region, cell_m, -0.5 * cell_m).within(first, near.shape)
        is_inside[areas[inside].ravel()] = True
        is_inside[0] = False
        return cls(~(unknown | obstacles), is_inside[areas])


def frontier_pieces(free: Bools, unseen: Bools, first: Cell, cell_m: float, robot: tuple[Cell, float]) -> list[Piece]:
    """The pieces, in squares, of the frontier beside `unseen`: those longer than the robot.

    Of a longer frontier whose pieces are all shorter the longest one counts. `robot` is its cell and radius, m. A place
    counts whose free cells are connected to the robot's, or cover a piece's square: a room may have been seen through a
    door that the map has closed since.
    """
    here, radius_m = robot
    places, _ = ndimage.label(free)
    is_place = np.bincount(places.ravel()) * cell_m**2 >= PIECE_M**2
    is_place[places[here]] = True
    is_place[0] = False
    frontier = is_place[places] & _with_neighbours(unseen)
    edge = np.argwhere(frontier)
    if len(edge) == 0:
        return []
    parts, _ = ndimage.label(frontier, _AROUND)
    square = (edge + first) // max(1, round(PIECE_M / cell_m))
    square -= square.min(axis=0)
    rows, cols = (square.max(axis=0) + 1).tolist()
    part_of = parts[tuple(edge.T)].astype(np.int64)
    keys, which, lengths = np.unique(
        (part_of * rows + square[:, 0]) * cols + square[:, 1], return_inverse=True, return_counts=True
    )
    part, robot_length = keys // (rows * cols), 2.0 * radius_m / cell_m
    is_longest = lengths == ndimage.maximum(lengths, part, part)
    is_piece = (lengths >= robot_length) | (is_longest & (np.bincount(part_of)[part] >= robot_length))
    around = np.clip(edge[:, None] + _BESIDE, 0, np.array(unseen.shape) - 1)
    k, side = np.nonzero(unseen[around[..., 0], around[..., 1]])
    row, col = around[k, side].T
    beside = np.unique((which[k] * unseen.shape[0] + row) * unseen.shape[1] + col)
    of_piece, flat = np.divmod(beside, unseen.size)
    cells = np.split(edge[np.argsort(which, kind="stable")], np.cumsum(lengths)[:-1])
    unseen_cells = np.split(
        np.column_stack(np.divmod(flat, unseen.shape[1])), np.searchsorted(of_piece, np.arange(1, len(keys)))
    )
    return [Piece(cells[k], unseen_cells[k]) for k in np.flatnonzero(is_piece)]


def _opened(mask: Bools) -> Bools:
    """(H, W) a mask without what is narrower than three cells: much faster than by `scipy.ndimage`."""
    across = mask[:, :-2] & mask[:, 1:-1] & mask[:, 2:]
    core = across[:-2] & across[1:-1] & across[2:]
    opened = np.zeros_like(mask)
    for row, col in np.ndindex(3, 3):
        opened[row : row + core.shape[0], col : col + core.shape[1]] |= core
    return opened


def _with_neighbours(mask: Bools) -> Bools:
    """(H, W) the cells of a mask, and those across their edges."""
    around = np.pad(mask, 1)
    across, along = around[1:-1, :-2] | around[1:-1, 2:], around[:-2, 1:-1] | around[2:, 1:-1]
    return mask | across | along


def frontier_points(
    grid: Grid, cell_m: float, region: Region | None, outside_m: float, at: Array, radius_m: float
) -> Array:
    """(N, 2) centres of the cells of the frontier that a robot at a place (2,) explores by, world frame, metres."""
    box, seen, obstacles = grid.box, grid.seen, grid.obstacles
    if not seen.size:
        return np.zeros((0, 2))
    first = box.top, box.left
    if region is None:
        region = box.left * cell_m, box.top * cell_m, box.right * cell_m, box.bottom * cell_m
    known = Known.of(seen, obstacles, first, cell_m, region, outside_m)
    here = np.clip(np.floor(at[::-1] / cell_m).astype(int) - first, 0, np.array(seen.shape) - 1).tolist()
    pieces = frontier_pieces(known.free, known.unseen, first, cell_m, (tuple(here), radius_m))
    cells = np.concatenate([np.zeros((0, 2), dtype=np.int64), *(piece.cells for piece in pieces)])
    return np.asarray((cells + first + 0.5)[:, ::-1] * cell_m)


def cells_within(region: Region, cell_m: float, margin_m: float) -> Box:
    """The cells that a region and a margin around it touch."""
    x0, y0, x1, y1 = region
    top, left = (math.floor((low - margin_m) / cell_m + TOUCH) for low in (y0, x0))
    bottom, right = (math.ceil((high + margin_m) / cell_m - TOUCH) for high in (y1, x1))
    return Box(top, left, max(bottom, top), max(right, left))
