"""A campus that is drawn from a few numbers."""

import numpy as np
import pytest
from scipy.ndimage import label

from sixthsense.sources.campus import Campus, campus_walls
from sixthsense.sources.scene import SceneError, load_scene

SMALL = Campus((3, 2), 27.0, 3.0, 0.3, 1.0, 4)
TABLE = """\
start = [1.5, 1.5, 0.0]
radius = 0.2
[campus]
blocks = [3, 2]
block_m = 27.0
corridor_m = 3.0
halls = 0.3
furniture = 1.0
seed = 4
"""
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
    assert campus_walls(SMALL) == campus_walls(SMALL) != campus_walls(SMALL._replace(seed=5))


def test_a_scene_with_a_campus_may_have_walls_of_its_own(tmp_path):
    (tmp_path / "one.toml").write_text("walls = [[1.0, 0.0, 1.0, 0.5]]\n" + TABLE)
    assert len(load_scene(tmp_path / "one.toml").walls) == len(campus_walls(SMALL)) + 1
    assert load_scene(tmp_path / "one.toml").region == (0.0, 0.0, 93.0, 63.0)


def test_the_shipped_campus_has_three_hundred_metres_and_a_thousand_rooms():
    scene = load_scene("campus")
    assert scene.region == (0.0, 0.0, 303.0, 303.0) and 5_000 < len(scene.walls) < 50_000


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ("blocks = [3, 2]", "blocks = [3, 0]", "campus.blocks, campus.seed: found 3 x 0 and 4, allowed: whole numbers"),
        ("blocks = [3, 2]", "blocks = [3, 500]", "campus.blocks, campus.seed: found 3 x 500 and 4, allowed: whole"),
        ("blocks = [3, 2]", "blocks = [3]", "campus.blocks: found [3], allowed: 2 numbers (x y)"),
        ("seed = 4", "seed = 1.5", "campus.blocks, campus.seed: found 3 x 2 and 1.5, allowed: whole numbers"),
        (
            "block_m = 27.0",
            "block_m = 5.0",
            "campus.block_m, campus.corridor_m: found 5, 3, allowed: at least 20 and 1",
        ),
        ("halls = 0.3", "halls = 2", "campus.halls, campus.furniture: found 2, 1, allowed: 0 to 1, 0 to 3"),
        ("halls = 0.3", "hall = 0.3", "campus.hall: no such field, did you mean halls? allowed: blocks, block_m"),
        ("seed = 4", "", "campus.seed: missing, required are blocks"),
        ("[campus]", "campus = 3\n[other]", "other: no such field"),
    ],
)
def test_a_wrong_number_is_named(before, after, found, tmp_path):
    (tmp_path / "one.toml").write_text(TABLE.replace(before, after))
    with pytest.raises(SceneError) as error:
        load_scene(tmp_path / "one.toml")
    assert str(error.value).startswith(f"{tmp_path / 'one.toml'}: {found}")
