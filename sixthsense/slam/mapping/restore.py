"""A grid from the counts that a run's folder keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.slam.mapping.evidence import Cells, are_obstacles
from sixthsense.slam.mapping.grid import Grid


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
    grid._first = round(origin[1] / config.cell_m), round(origin[0] / config.cell_m)
    obstacles = are_obstacles(hits, passes, config)
    height, width = hits.shape
    rim = int(grid._stencil.max())
    cover = np.zeros((height + 2 * rim, width + 2 * rim), dtype=np.int32)
    for row, col in (grid._stencil + rim).tolist():
        cover[row : row + height, col : col + width] += obstacles
    inner = cover[rim : rim + height, rim : rim + width].copy()
    grid._cells = Cells(hits.copy(), passes.copy(), inner, np.zeros_like(hits), seen.copy(), obstacles)
    grid._flat_stencil = grid._stencil[:, 0] * width + grid._stencil[:, 1]
    return grid
