"""Submaps: the evidence of some consecutive key scans, and a grid composed of them."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.evidence import Cells, EvidenceRules, Ints
from sixthsense.slam.mapping.freespace import Bools

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


def submap_of(cells: Cells, first: tuple[int, int]) -> Submap:
    """The evidence in the cells (H, W) of a grid, whose cell (0, 0) is `first` from the world's origin."""
    hits, passes, seen = cells.hits.ravel(), cells.passes.ravel(), cells.seen.ravel()
    touched = np.flatnonzero((hits > 0) | seen)  # what is passed is seen
    rows, cols = np.divmod(touched, cells.hits.shape[1])
    places = np.stack([rows + first[0], cols + first[1]], axis=1)
    return Submap.of(places, hits[touched], passes[touched], seen[touched])


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
def add_submap(grid: Cells, first: tuple[int, int], submap: Submap, rules: EvidenceRules) -> None:
    """Add the evidence of a submap, later than all before it, to hits, passes and seen of `grid` (H, W).

    As with single scans, a hit cuts the earlier passes to the most that leave an obstacle; and a cell that is an
    obstacle by the submap alone is one in the grid, however long it was free before.
    """
    for i in range(len(submap.cells)):
        row, col = submap.cells[i, 0] - first[0], submap.cells[i, 1] - first[1]
        hits, passes = grid.hits[row, col], grid.passes[row, col]
        if submap.hits[i] > 0:
            hits = min(hits + submap.hits[i], rules.max_hits)
            passes = min(passes, int(rules.passes_per_hit * hits))
        passes += submap.passes[i]
        if submap.hits[i] > 0 and submap.passes[i] <= rules.passes_per_hit * submap.hits[i]:
            passes = min(passes, int(rules.passes_per_hit * hits))
        grid.hits[row, col], grid.passes[row, col] = hits, passes
        if submap.seen[i]:
            grid.seen[row, col] = True


@numba.njit(cache=True, error_model="numpy")
def mark_obstacles(grid: Cells, stencil: NDArray[np.int64], rules: EvidenceRules) -> None:
    """Mark the obstacles of `grid` (H, W), which has none yet, by its counts; `stencil` (K,) flat offsets to cover."""
    hits, passes = grid.hits.ravel(), grid.passes.ravel()
    obstacles, cover = grid.obstacles.ravel(), grid.cover.ravel()
    for cell in range(len(hits)):
        if hits[cell] > 0 and hits[cell] >= rules.min_hits and passes[cell] <= rules.passes_per_hit * hits[cell]:
            obstacles[cell] = True
            for offset in stencil:
                cover[cell + offset] += 1
