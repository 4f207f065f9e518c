"""Submaps: the evidence of some consecutive keyframes, of which a grid is composed."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.changes import SHIFT, TILE, Box, box_of
from sixthsense.slam.mapping.evidence import MOST_RETURNS, Cells, EvidenceRules, Ints, Offsets, Tiles
from sixthsense.slam.mapping.freespace import Bools

_OLD_HITS = 3


class Submap(NamedTuple):
    """The evidence of a few scans."""

    cells: NDArray[np.int64]
    """(N, 2) row, col from the world's origin"""
    hits: Ints
    """(N,) as of a grid that has these scans alone"""
    passes: Ints
    """(N,) likewise"""
    seen: Bools
    """(N,) likewise"""
    places: Offsets
    """(N, 3) the returns, and the offset of their mean from the cell's centre, as of `Cells`"""

    @classmethod
    def of(cls, tiles: Tiles) -> Submap:
        """All evidence of a grid's tiles, row by row."""
        kept = tiles.cells
        slots = np.flatnonzero((kept.hits > 0) | kept.seen)  # what is passed is seen
        within = np.stack([(slots >> SHIFT) & (TILE - 1), slots & (TILE - 1)], axis=1)
        cells = tiles.squares[slots >> (2 * SHIFT)] * TILE + np.array(tiles.first) + within
        order = np.lexsort((cells[:, 1], cells[:, 0]))
        slots, cells = slots[order], cells[order]
        places = np.stack([kept.returns[slots], kept.down[slots], kept.across[slots]], axis=1).astype(np.int16)
        return cls(cells, kept.hits[slots].astype(np.int32), kept.passes[slots], kept.seen[slots], places)

    @property
    def box(self) -> Box:
        """That holds the cells."""
        return box_of(self.cells) if len(self.cells) else Box(0, 0, 0, 0)

    def within(self, squares: Bools, first: tuple[int, int]) -> Submap:
        """The part of it in squares (R, C) of an index whose first cell is `first`."""
        kept = np.flatnonzero(squares[tuple(((self.cells - np.array(first)) >> SHIFT).T)])
        return Submap(self.cells[kept], self.hits[kept], self.passes[kept], self.seen[kept], self.places[kept])

    def weakened(self, rules: EvidenceRules) -> Submap:
        """The same obstacles and free cells by the evidence of `_OLD_HITS` scans at most, none of them seen.

        What was there in an earlier run is soon erased where it is gone, and has to be seen again.
        """
        hits = np.minimum(self.hits, max(_OLD_HITS, rules.min_hits))
        is_free = self.passes > rules.passes_per_hit * self.hits
        most = np.floor(rules.passes_per_hit * hits).astype(np.int32)
        shrunk = (self.passes * (hits / np.maximum(self.hits, 1))).astype(np.int32)
        passes = np.where(is_free, np.minimum(self.passes, most + 1), np.minimum(shrunk, most))
        passes, seen = passes.astype(np.int32), np.zeros_like(self.seen)
        return self._replace(hits=hits.astype(np.int32), passes=passes, seen=seen)


@numba.njit(cache=True, error_model="numpy")
def add_submap(cells: Cells, slots: NDArray[np.int64], submap: Submap, rules: EvidenceRules) -> None:
    """Add the evidence of a submap at `slots` (N,), later than all before it, but for which cells are obstacles.

    As with single scans, a hit cuts the earlier passes to the most that leave an obstacle; and a cell that is an
    obstacle by the submap alone is one in the grid, however long it was free before.
    """
    for i in range(len(slots)):
        cell = slots[i]
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
