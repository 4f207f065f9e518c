"""Closed walls that are kept up to date are those of a computation from scratch."""

import numpy as np
import pytest
from scipy import ndimage

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.navigation.closed_walls import ClosedWalls
from sixthsense.navigation.frontier import close_gaps
from sixthsense.navigation.map_window import MapWindow
from sixthsense.navigation.regions import frontier_cells
from sixthsense.slam.mapping.grid import Grid

REGION = (-2.0, -1.5, 2.5, 1.0)


def random_scan(rng: np.random.Generator) -> Scan:
    ranges = rng.choice([0.4, 0.8, 1.1, np.inf], 90).repeat(2).astype(np.float32)
    return Scan(ranges, np.float32(-np.pi), np.float32(2.0 * np.pi / 180), 1.5)


def window_of(grid: Grid) -> MapWindow:
    space = grid.free_space()
    height, width = space.blocked.shape
    return MapWindow.of(grid, space, (slice(8, height - 5), slice(3, width - 9)), REGION)


@pytest.mark.parametrize("seed", range(6))
def test_closed_walls_follow_a_map_that_grows_and_is_drawn_again(seed: int) -> None:
    rng, grid, closed_walls = np.random.default_rng(seed), Grid(GridConfig(), 0.2), ClosedWalls(seed % 3)
    for k in range(40):
        if k == 25:
            grid.clear()
        for _ in range(int(rng.integers(1, 4))):
            pose = Pose(*rng.uniform((-1.5, -1.0, -3.0), (1.5, 1.0, 3.0)))
            grid.add(pose, random_scan(rng), np.zeros((0, 2, 2)))
        window = window_of(grid)
        closed, opaque, edge = closed_walls.close(window, grid)
        again = closed_walls.close(window, grid).window
        first, shape = window.first, window.seen.shape
        row, col = round(grid.origin[1] / 0.05) - first[0], round(grid.origin[0] / 0.05) - first[1]
        part = slice(-row, shape[0] - row), slice(-col, shape[1] - col)
        wall = (grid.hits[part] >= 3) & (grid.passes[part] <= 15 * grid.hits[part])
        obstacles = close_gaps(window.obstacles | wall)
        assert np.array_equal(closed.obstacles, obstacles) and np.array_equal(again.obstacles, obstacles)
        wide = np.ones((2 * (seed % 3) + 1,) * 2, dtype=np.bool_)
        assert np.array_equal(opaque, ndimage.binary_dilation(obstacles, wide))
        assert np.array_equal(closed.unseen, window.unseen & ~obstacles)
        expected = frontier_cells(window.seen & ~obstacles, ~(window.seen | obstacles))
        assert np.array_equal(edge, np.argwhere(expected))
