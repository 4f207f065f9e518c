"""Cells in tiles are found where they were put, and take memory only where a scan has been."""

import numpy as np
import pytest

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import Box, Changes
from sixthsense.slam.mapping.evidence import EvidenceRules, Tiles, slot
from sixthsense.slam.mapping.grid import Grid


@pytest.mark.parametrize("seed", range(5))
def test_cells_are_found_again_in_an_index_that_grows_to_all_sides_until_they_are_erased(seed: int) -> None:
    rng, tiles, kept = np.random.default_rng(seed), Tiles(EvidenceRules(1, 300, 4.0)), {}
    for k in range(1, 12):
        reach = 40 * k
        cells = np.unique(rng.integers(-reach, reach, size=(30, 2)), axis=0)
        tiles.cover(Box(-reach, -reach, reach, reach))
        slots = tiles.slots(cells)
        assert slots.tolist() == [slot(tiles.index, *cell) for cell in (cells - tiles.first).tolist()]
        tiles.cells.hits[slots] = values = rng.integers(1, 300, len(cells))
        kept |= dict(zip(map(tuple, cells.tolist()), values.tolist(), strict=True))
        box = Box(-reach - 3, 5 - reach, reach // 2, reach + 70)
        if k % 4 == 0:
            tiles.erase(tiles.touched_by([Box(3, -9, 4, -8)]))
            kept = {(row, col): value for (row, col), value in kept.items() if not (0 <= row < 64 and -64 <= col < 0)}
        expected = np.zeros((box.bottom - box.top, box.right - box.left), dtype=np.int32)
        for (row, col), value in kept.items():
            if box.top <= row < box.bottom and box.left <= col < box.right:
                expected[row - box.top, col - box.left] = value
        assert np.array_equal(tiles.part(tiles.cells.hits, box), expected)
        tiles.mark_obstacles(tiles.index >= 0)
        assert np.array_equal(tiles.part(tiles.cells.obstacles, box), expected > 0)


def test_two_rooms_far_apart_take_no_memory_between_them() -> None:
    grid = Grid(GridConfig(), 0.2)
    scan = Scan(np.full(90, 3.0, dtype=np.float32), np.float32(-np.pi), np.float32(2.0 * np.pi / 90), 10.0)
    grid.add(Pose(), scan)
    alone = len(grid.submap().cells)
    grid.add(Pose(700.0, 900.0), scan)
    assert len(grid.submap().cells) == pytest.approx(2 * alone, rel=0.05)
    assert len(grid._tiles.cells.hits) < 20 * alone
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
