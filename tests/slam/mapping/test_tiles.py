"""Cells in tiles are found where they were put, and take memory only where a scan has been."""

import numpy as np
import pytest

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import TILE, Box, Changes
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.tiles import Tiles, slot

NO_WALLS = np.zeros((0, 2, 2))


@pytest.mark.parametrize("seed", range(5))
def test_cells_are_found_again_in_an_index_that_grows_to_all_sides(seed: int) -> None:
    rng, tiles, pool, kept = np.random.default_rng(seed), Tiles(), np.zeros(0, dtype=np.int32), {}
    for k in range(1, 12):
        reach = 40 * k
        cells = np.unique(rng.integers(-reach, reach, size=(30, 2)), axis=0)
        tiles.cover(Box(-reach, -reach, reach, reach))
        places = tiles.places(cells)
        tiles.allocate(tiles.lacking(tiles.around(places, 0), (0, 0)))
        pool = np.concatenate([pool, np.zeros(len(tiles.squares) * TILE * TILE - len(pool), dtype=np.int32)])
        slots = tiles.slots(places)
        assert slots.tolist() == [slot(tiles.index, place) for place in places.tolist()]
        pool[slots] = values = rng.integers(1, 1000, len(cells))
        kept |= dict(zip(map(tuple, cells.tolist()), values.tolist(), strict=True))
        box = Box(-reach - 3, 5 - reach, reach // 2, reach + 70)
        expected = np.zeros((box.bottom - box.top, box.right - box.left), dtype=np.int32)
        for (row, col), value in kept.items():
            if box.top <= row < box.bottom and box.left <= col < box.right:
                expected[row - box.top, col - box.left] = value
        assert np.array_equal(tiles.part(pool, box), expected)


def test_the_squares_around_places_are_those_of_all_cells_within_the_reach() -> None:
    tiles = Tiles()
    tiles.cover(Box(0, 0, 6 * TILE, 7 * TILE))
    for row, col, reach in ((200, 210, 5), (128, 191, 1), (190, 250, 70), (192, 256, 0)):
        expected = np.zeros((6, 7), dtype=np.bool_)
        for r in range(row - reach, row + reach + 1):
            for c in range(col - reach, col + reach + 1):
                expected[r // TILE, c // TILE] = True
        assert np.array_equal(tiles.around(tiles.places(np.array([[row, col]])), reach), expected)


def test_two_rooms_far_apart_take_no_memory_between_them() -> None:
    grid = Grid(GridConfig(), 0.2)
    scan = Scan(np.full(90, 3.0, dtype=np.float32), np.float32(-np.pi), np.float32(2.0 * np.pi / 90), 10.0)
    grid.add(Pose(), scan, NO_WALLS)
    alone = len(grid.submap().cells)
    grid.add(Pose(700.0, 900.0), scan, NO_WALLS)
    assert len(grid.submap().cells) == pytest.approx(2 * alone, rel=0.05)
    assert len(grid._cells.hits) < 20 * alone
    with pytest.raises(ValueError, match="allowed: at most 100,000,000 cells"):
        grid.free_space()


def test_changes_are_those_since_a_revision() -> None:
    changes = Changes()
    before = changes.revision
    assert changes.since(before) == Box(0, 0, 0, 0) and changes.since(None) is None
    changes.add(Box(1, 2, 3, 4))
    middle = changes.revision
    changes.add(Box(0, 5, 2, 9))
    assert changes.since(before) == Box(0, 2, 3, 9) and changes.since(middle) == Box(0, 5, 2, 9)
    changes.add_all()
    assert changes.since(middle) is None and changes.since(changes.revision) == Box(0, 0, 0, 0)


def test_a_cell_of_a_mask_is_found_within_a_reach_and_not_beyond() -> None:
    rng, tiles = np.random.default_rng(5), Tiles()
    tiles.cover(Box(-70, -33, 140, 205))
    tiles.allocate(np.argwhere(rng.random(tiles.index.shape) < 0.6))
    mask = rng.random(len(tiles.squares) * TILE**2) < 0.005
    box, found = Box(-150, -120, 220, 290), []
    rows, cols = np.nonzero(tiles.part(mask, box))
    for _ in range(200):
        row, col, reach = int(rng.integers(-120, 190)), int(rng.integers(-90, 250)), rng.uniform(0.3, 20.0)
        is_near = (np.hypot(rows + box.top - row, cols + box.left - col) <= reach).any()
        assert tiles.has_within(mask, (row, col), reach) == is_near
        found.append(is_near)
    assert 0.2 < np.mean(found) < 0.8
