"""A grid from the counts that a run's folder keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.submap import mark_obstacles


def restore_grid(
    config: GridConfig,
    radius_m: float,
    origin: tuple[float, float],
    hits: NDArray[np.int32],
    passes: NDArray[np.int32],
    seen: NDArray[np.bool_],
) -> Grid:
    """The grid that has these counts: what `hits`, `passes`, `seen` and `origin` of another one said.

    Obstacles and their inflation follow from the counts; scans may be added to it as to the other one. Raises
    ValueError for arrays of different shapes and for an origin that is not finite.
    """
    if not hits.ndim == 2 or not hits.shape == passes.shape == seen.shape:
        raise ValueError(f"counts: expected one shape (H, W), got {hits.shape}, {passes.shape} and {seen.shape}")
    if not np.isfinite(origin).all():
        raise ValueError(f"origin: found {origin}, allowed: finite numbers")
    grid = Grid(config, radius_m)
    row, col = round(origin[1] / config.cell_m), round(origin[0] / config.cell_m)
    grid._box = Box(row, col, row + hits.shape[0], col + hits.shape[1])
    grid._tiles.cover(grid._box.grown(grid._reach))
    rows, cols = np.nonzero((hits > 0) | (passes > 0) | seen)
    kept = rows, cols
    places = grid._make_room(np.stack([rows + row, cols + col], axis=1), hits[kept] > 0)
    slots, cells = grid._tiles.slots(places), grid._cells
    cells.hits[slots], cells.passes[slots], cells.seen[slots] = hits[kept], passes[kept], seen[kept]
    mark_obstacles(cells, grid._tiles.index, grid._tiles.squares, grid._offsets, grid._rules)
    return grid
