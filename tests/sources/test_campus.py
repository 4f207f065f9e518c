"""A campus that is drawn from a few numbers."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import label

from sixthsense.sources.campus import Campus, campus_walls
from sixthsense.sources.scene import load_scene

SMALL = Campus((3, 2), 27.0, 3.0, 0.3, 1.0, 4)
CELL_M = 0.1


def drawn(walls, size):
    """Cells that walls cross."""
    cells = np.zeros(np.round(np.array(size) / CELL_M).astype(int) + 2, dtype=bool)
    for a, b in np.array(walls):
        points = a + np.linspace(0.0, 1.0, int(np.hypot(*(b - a)) / 0.03) + 2)[:, None] * (b - a)
        cells[tuple(np.floor(points / CELL_M).astype(int).T)] = True
    return cells


def test_every_room_and_hall_is_reached_through_doors():
    cells = drawn(campus_walls(SMALL), (93.0, 63.0))
    areas, _ = label(~cells[1:-2, 1:-2])
    sizes = np.bincount(areas.ravel())[1:] * CELL_M**2
    assert sizes.max() > 0.95 * 93.0 * 63.0 - 200.0  # without the walls
    assert np.sort(sizes)[-2] < 2.0  # the inside of furniture and pillars


def test_one_seed_is_one_campus_and_another_is_another():
    assert np.array_equal(campus_walls(SMALL), campus_walls(SMALL))
    assert not np.array_equal(campus_walls(SMALL), campus_walls(replace(SMALL, seed=5)))


def test_the_shipped_campus_has_three_hundred_metres_and_a_thousand_rooms():
    scene = load_scene("campus")
    assert scene.region == (0.0, 0.0, 303.0, 303.0) and 5_000 < len(scene.walls) < 50_000
