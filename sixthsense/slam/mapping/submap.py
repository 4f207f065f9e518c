"""Submaps: the evidence of some consecutive key scans, and a grid composed of them."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.evidence import Cells, EvidenceRules, Ints
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.tiles import ROW, SHIFT, TILE, Index, Places, Tiles, slot

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
    corners: NDArray[np.int64]
    """(2, 2) least and greatest row, col; (0, 2) of an empty submap"""

    @classmethod
    def of(cls, cells: NDArray[np.int64], hits: Ints, passes: Ints, seen: Bools) -> Submap:
        """The submap of (N,) cells, none of them twice."""
        corners = np.zeros((0, 2), dtype=np.int64)
        if len(cells):
            corners = np.array([[column.min() for column in cells.T], [column.max() for column in cells.T]])
        return cls(cells, hits, passes, seen, corners)


def submap_of(cells: Cells, tiles: Tiles) -> Submap:
    """The evidence in the cells of a grid's tiles, row by row."""
    touched = np.flatnonzero((cells.hits > 0) | cells.seen)  # what is passed is seen
    corner = tiles.squares[touched >> (2 * SHIFT)] * TILE + np.array(tiles.first)
    places = corner + np.stack([(touched >> SHIFT) & (TILE - 1), touched & (TILE - 1)], axis=1)
    order = np.lexsort((places[:, 1], places[:, 0]))
    touched = touched[order]
    return Submap.of(places[order], cells.hits[touched], cells.passes[touched], cells.seen[touched])


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
    return Submap(submap.cells, hits.astype(np.int32), passes.astype(np.int32), seen, submap.corners)


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


@numba.njit(cache=True, error_model="numpy")
def mark_obstacles(
    cells: Cells, index: Index, squares: NDArray[np.int64], stencil: Places, rules: EvidenceRules
) -> None:
    """Mark the obstacles of tiles in (T, 2) `squares`, which have none yet; `stencil` (K,) offsets to cover."""
    hits, passes = cells.hits, cells.passes
    for cell in range(len(squares) << (2 * SHIFT)):
        if hits[cell] > 0 and hits[cell] >= rules.min_hits and passes[cell] <= rules.passes_per_hit * hits[cell]:
            cells.obstacles[cell] = True
            square = squares[cell >> (2 * SHIFT)]
            row, col = (square[0] << SHIFT) + ((cell >> SHIFT) & (TILE - 1)), (square[1] << SHIFT) + (cell & (TILE - 1))
            for offset in stencil:
                cells.cover[slot(index, row * ROW + col + offset)] += 1
