"""Submaps: the evidence of some consecutive keyframes, and a grid composed of them."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.changes import SHIFT, TILE, Box, box_of
from sixthsense.slam.mapping.evidence import MOST_RETURNS, Cells, EvidenceRules, Ints, Offsets
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.tiles import ROW, Index, Places, Tiles, slot

_OLD_HITS = 3


class Submap(NamedTuple):
    """What a few scans say of the cells that they touch."""

    cells: NDArray[np.int64]
    """(N, 2) row, col from the world's origin"""
    hits: Ints
    """(N,) as of a grid that has these scans alone"""
    passes: Ints
    """(N,) likewise"""
    seen: Bools
    """(N,) likewise"""
    box: Box
    """that holds the cells"""
    places: Offsets
    """(N, 3) the returns, and the offset of their mean from the cell's centre, as of `Cells`"""

    @classmethod
    def of(
        cls, cells: NDArray[np.int64], hits: Ints, passes: Ints, seen: Bools, places: Offsets | None = None
    ) -> Submap:
        """The submap of (N,) cells, none of them twice; its obstacles are at their cells' centres unless it is said."""
        if places is None:
            places = np.zeros((len(cells), 3), dtype=np.int16)
        return cls(cells, hits, passes, seen, box_of(cells) if len(cells) else Box(0, 0, 0, 0), places)

    def within(self, squares: Bools, tiles: Tiles) -> Submap:
        """The part of it in squares (R, C) of the tiles' index."""
        kept = _in_squares(self.cells, tiles.first, squares)
        return Submap(
            self.cells[kept], self.hits[kept], self.passes[kept], self.seen[kept], self.box, self.places[kept]
        )


def submap_of(cells: Cells, tiles: Tiles) -> Submap:
    """The evidence in the cells of a grid's tiles, row by row."""
    touched = np.flatnonzero((cells.hits > 0) | cells.seen)  # what is passed is seen
    corner = tiles.squares[touched >> (2 * SHIFT)] * TILE + np.array(tiles.first)
    places = corner + np.stack([(touched >> SHIFT) & (TILE - 1), touched & (TILE - 1)], axis=1)
    order = np.lexsort((places[:, 1], places[:, 0]))
    touched = touched[order]
    hits = cells.hits[touched].astype(np.int32)
    returns = np.stack([cells.returns[touched], cells.down[touched], cells.across[touched]], axis=1).astype(np.int16)
    return Submap.of(places[order], hits, cells.passes[touched], cells.seen[touched], returns)


def weakened(submap: Submap, rules: EvidenceRules) -> Submap:
    """The same obstacles and free cells by the evidence of `_OLD_HITS` scans at most, none of them seen.

    What was there in an earlier run is soon erased where it is gone, and has to be seen again.
    """
    hits = np.minimum(submap.hits, max(_OLD_HITS, rules.min_hits))
    is_free = submap.passes > rules.passes_per_hit * submap.hits
    most = np.floor(rules.passes_per_hit * hits).astype(np.int32)
    shrunk = (submap.passes * (hits / np.maximum(submap.hits, 1))).astype(np.int32)
    passes = np.where(is_free, np.minimum(submap.passes, most + 1), np.minimum(shrunk, most))
    seen = np.zeros_like(submap.seen)
    return submap._replace(hits=hits.astype(np.int32), passes=passes.astype(np.int32), seen=seen)


@numba.njit(cache=True, error_model="numpy")
def _in_squares(cells: NDArray[np.int64], first: tuple[int, int], squares: Bools) -> NDArray[np.int64]:
    """Which of the cells (N, 2) are in squares (R, C) that begin at the cell `first`."""
    kept, count = np.empty(len(cells), np.int64), 0
    for i in range(len(cells)):
        if squares[(cells[i, 0] - first[0]) >> SHIFT, (cells[i, 1] - first[1]) >> SHIFT]:
            kept[count] = i
            count += 1
    return kept[:count]


@numba.njit(cache=True, error_model="numpy")
def add_submap(cells: Cells, index: Index, places: Places, submap: Submap, rules: EvidenceRules) -> None:
    """Add the evidence of a submap at `places` (N,), later than all before it, to hits, passes and seen of the tiles.

    As with single scans, a hit cuts the earlier passes to the most that leave an obstacle; and a cell that is an
    obstacle by the submap alone is one in the grid, however long it was free before.
    """
    for i in range(len(places)):
        cell = slot(index, places[i])
        hits, passes = cells.hits[cell], cells.passes[cell]
        if submap.hits[i] > 0:
            hits = min(hits + submap.hits[i], rules.max_hits)
            passes = min(passes, int(rules.passes_per_hit * hits))
        passes += submap.passes[i]
        if submap.hits[i] > 0 and submap.passes[i] <= rules.passes_per_hit * submap.hits[i]:
            passes = min(passes, int(rules.passes_per_hit * hits))
        cells.hits[cell], cells.passes[cell] = hits, passes
        if submap.seen[i]:
            cells.seen[cell] = True
        if submap.hits[i] > 0:
            returns, before = submap.places[i, 0], cells.returns[cell]
            share = 1.0 if before == 0 else returns / (returns + before)
            cells.returns[cell] = min(returns + before, MOST_RETURNS)
            cells.down[cell] += round(share * (submap.places[i, 1] - cells.down[cell]))
            cells.across[cell] += round(share * (submap.places[i, 2] - cells.across[cell]))


@numba.njit(cache=True, error_model="numpy")
def mark_obstacles(
    cells: Cells, index: Index, squares: NDArray[np.int64], stencil: Places, rules: EvidenceRules
) -> None:
    """Mark the obstacles of the tiles in (T, 2) `squares`, which have none yet; `stencil` (K,) offsets to cover."""
    hits, passes = cells.hits, cells.passes
    for row, col in squares:
        first = np.int64(index[row, col]) << (2 * SHIFT)
        for cell in range(first, first + TILE * TILE):
            if hits[cell] > 0 and hits[cell] >= rules.min_hits and passes[cell] <= rules.passes_per_hit * hits[cell]:
                cells.obstacles[cell] = True
                place = _place(row, col, cell)
                for offset in stencil:
                    cells.cover[slot(index, place + offset)] += 1


@numba.njit(cache=True, error_model="numpy")
def erase(cells: Cells, index: Index, squares: NDArray[np.int64], stencil: Places) -> None:
    """Remove the evidence of the tiles in (T, 2) `squares`; `stencil` (K,) offsets that an obstacle covers."""
    for row, col in squares:
        first = np.int64(index[row, col]) << (2 * SHIFT)
        for cell in range(first, first + TILE * TILE):
            if cells.obstacles[cell]:
                place = _place(row, col, cell)
                for offset in stencil:
                    cells.cover[slot(index, place + offset)] -= 1
            cells.hits[cell], cells.passes[cell], cells.stamp[cell] = 0, 0, 0
            cells.seen[cell], cells.obstacles[cell] = False, False
            cells.returns[cell], cells.down[cell], cells.across[cell] = 0, 0, 0


@numba.njit(cache=True, error_model="numpy")
def _place(row: int, col: int, cell: int) -> int:
    """The place of a cell in the tile of a square."""
    return ((row << SHIFT) + ((cell >> SHIFT) & (TILE - 1))) * ROW + (col << SHIFT) + (cell & (TILE - 1))
