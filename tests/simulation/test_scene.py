from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.simulation.mission import mission_of, unreachable
from sixthsense.simulation.ros_map import outline_corners, simplified
from sixthsense.simulation.scene import Scene, check_places, load_scene
from sixthsense.simulation.scene_grid import SceneGrid

GOOD = """
start = [2.3, 3.4, 0.7]
radius = 0.2
goal = [4.5, 3.9]
tour = [[4.5, 3.6], [2.5, 4.1]]
region = [1.6, 2.8, 5.4, 4.3]
"""
SIDES = [[1.5, 2.5, 5.5, 2.5], [5.5, 2.5, 5.5, 4.5], [5.5, 4.5, 1.5, 4.5], [1.5, 4.5, 1.5, 2.5]]
ROOM = f"walls = {SIDES}\n"
SQUARE = [[[0, 0], [6, 0]], [[6, 0], [6, 6]], [[6, 6], [0, 6]], [[0, 6], [0, 0]]]
MAP = {
    "image": "m.png", "resolution": "0.1", "origin": "[0, 0, 0]", "negate": "0", "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}  # fmt: skip


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def write_map(folder: Path, pixels: np.ndarray, image: str = "m.png", **fields: str) -> Path:
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / image)
    table = {**MAP, "image": image, **fields}
    return write(folder, "m.yaml", "".join(f"{k}: {v}\n" for k, v in table.items()))


def sides(scene: Scene) -> set[tuple[tuple[float, float], ...]]:
    return {tuple(sorted(map(tuple, np.round(wall, 9) + 0.0))) for wall in scene.walls}


def test_walls_and_polygons_give_the_same_segments(tmp_path: Path) -> None:
    polygon = "[[polygons]]\npoints = [[1.5, 2.5], [5.5, 2.5], [5.5, 4.5], [1.5, 4.5]]\n"
    a = load_scene(write(tmp_path, "a.toml", GOOD + ROOM))
    b = load_scene(write(tmp_path, "b.toml", GOOD + polygon))
    c = load_scene(str(write(tmp_path, "c.toml", GOOD + polygon + "closed = false\n")))
    assert a.walls.reshape(-1, 4).tolist() == SIDES
    assert sides(a) == sides(b) and len(c.walls) == 3 and sides(c) < sides(b)
    assert (a.name, a.radius, a.goal, a.tour) == ("a", 0.2, (4.5, 3.9), ((4.5, 3.6), (2.5, 4.1)))
    assert (a.start, a.region) == (Pose(2.3, 3.4, 0.7), (1.6, 2.8, 5.4, 4.3))
    bare = load_scene(write(tmp_path, "d.toml", GOOD.split("region")[0] + ROOM + "glass = [[3.5, 2.5, 3.5, 3.2]]\n"))
    assert bare.region == (1.5, 2.5, 5.5, 4.5) and (len(bare.walls), len(bare.solid)) == (4, 5)


@pytest.mark.parametrize(("old", "new", "said"), [
    ("start = [2.3, 3.4, 0.7]", "start = [2.3, 4.4, 0.7]", "start: found (2.3, 4.4), outside the region"),
    ("goal = [4.5, 3.9]", "goal = [5.35, 3.9]", "goal: found (5.35, 3.9), 0.15 m from a wall"),
    ("radius = 0.2", "radius = 0.2\nraduis = 0.2", "raduis: no such field, did you mean radius?"),
    ("0.7]", "90]", "start: found the heading 90, allowed: radians"),
    ("[1.5, 2.5, 5.5, 2.5]", "[1.5, 2.5, 1.5, 2.5]", "walls: found one of no length at (1.5, 2.5)"),
    (ROOM, "", "walls: found none, allowed: at least one wall or polygon"),
    (ROOM, ROOM + "glass = [[2, 0, 2]]\n", "glass, entry 1, entry 4: Field required"),
    (ROOM, ROOM + "glass = [[3.2, 3.8, 5.2, 3.8]]\n", "goal: found (4.5, 3.9), 0.1 m from a wall"),
    (ROOM, ROOM + "[[polygons]]\npoints = [[1.5, 2e6]]\n", "polygons, entry 1, points: found 2000000.0"),
])  # fmt: skip
def test_a_scene_that_cannot_be_is_refused_by_its_field(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD + ROOM
    with pytest.raises(InputError) as caught:
        load_scene(write(tmp_path, "a.toml", (GOOD + ROOM).replace(old, new)))
    assert said in str(caught.value)


def random_images() -> list[np.ndarray]:
    images = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        image = rng.random((rng.integers(1, 25), rng.integers(1, 25)))
        image = ndimage.gaussian_filter(image, rng.choice([0.0, 0.7, 1.5]))
        images.append(image > np.quantile(image, rng.uniform(0.1, 0.9)))
    return images


def test_outlines_are_the_edges_between_occupied_and_free_cells() -> None:
    for occupied in random_images():
        found = set()
        corners, ends = outline_corners(occupied)
        for loop in np.split(corners, ends[:-1]):
            for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                along = a + np.arange(np.abs(b - a).sum() + 1)[:, None] * np.sign(b - a)
                edges = {tuple(edge) for edge in np.hstack([along[:-1], along[1:]]).tolist()}
                assert not found & edges
                found |= edges
        padded, expected = np.pad(occupied, 1), set()
        sides = (-1, 0, 0, 0, 1, 0), (0, 1, 1, 0, 1, 1), (1, 0, 1, 1, 0, 1), (0, -1, 0, 1, 0, 0)
        for *free_side, x, y, to_x, to_y in sides:
            cells = np.argwhere(padded & ~np.roll(padded, np.negative(free_side), (0, 1)))[:, ::-1] - 1
            expected |= {tuple(row) for row in np.add(np.tile(cells, 2), (x, y, to_x, to_y)).tolist()}
        assert found == expected


@pytest.mark.parametrize("run", [1, 2, 3])
def test_a_slanted_wall_is_a_straight_one_and_no_corner_is_farther_off_than_half_a_cell(run: int) -> None:
    rows, cols = np.indices((60, 60))
    solid = cols >= rows // run + 7
    traced, ends = outline_corners(solid)
    kept, _ = simplified(traced.astype(np.float64), ends)
    assert len(kept) <= 8 < len(traced)
    off = [point_segment_distance(c, np.stack([kept, np.roll(kept, -1, axis=0)], axis=1)).min() for c in traced]
    assert max(off) <= 0.5 + 1e-9


def test_a_place_in_a_solid_is_not_free(tmp_path: Path) -> None:
    pixels = np.full((40, 60), 254)
    pixels[10:30, 20:45] = 0
    scene = load_scene(write_map(tmp_path, pixels, origin="[-1.3, 2.7, 0]"))
    check_places(scene, {"start": (0.2, 3.5)}, 0.2)
    with pytest.raises(InputError, match=r"start: found \(1.5, 4.9\), inside a wall, 0.8 m deep"):
        check_places(scene, {"start": (1.5, 4.9)}, 0.2)
    assert len(load_scene(write_map(tmp_path, pixels), "free").walls) == 4
    inverted = load_scene(write_map(tmp_path, 254 - pixels, origin="[-1.3, 2.7, 0]"))
    with pytest.raises(InputError, match=r"inside a wall, [.\d]+ m deep, allowed: a free place"):
        check_places(inverted, {"start": (0.2, 3.5)}, 0.2)


def test_the_same_pixels_give_the_same_walls_in_every_format(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    grey = rng.choice(np.array([0, 60, 120, 205, 254], np.uint8), (20, 30))
    expected = sides(load_scene(write_map(tmp_path, grey)))
    assert sides(load_scene(write_map(tmp_path, grey, image="m.pgm"))) == expected
    assert sides(load_scene(write_map(tmp_path, np.dstack([grey] * 3)))) == expected
    assert sides(load_scene(write_map(tmp_path, 255 - grey, negate="True", mode="Trinary"))) == expected
    path = write_map(tmp_path, grey)
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "m.png")
    assert sides(load_scene(path)) == expected


@pytest.mark.parametrize("free_thresh", ["0.25", "0.7"])
def test_what_a_saver_wrote_as_unknown_stays_so_with_a_note(tmp_path: Path, free_thresh: str) -> None:
    grey = np.full((20, 30), 205)  # as map_saver writes a room that was seen in part, and a wall in it
    grey[4:15, 3:21], grey[4, 3:21], grey[6:9, 11] = 254, 0, 0
    expected = load_scene(write_map(tmp_path, grey))
    found = load_scene(write_map(tmp_path, grey, free_thresh=free_thresh))
    assert sides(found) == sides(expected) and not expected.notes
    assert f"with free_thresh {free_thresh} Nav2's map_server takes them as free" in found.notes[0]
    other_grey = load_scene(write_map(tmp_path, np.where(grey == 254, 240, grey), free_thresh=free_thresh))
    assert sides(other_grey) != sides(expected) and not other_grey.notes


@pytest.mark.parametrize(("task", "given", "goals"), [
    ("goal", {}, [[4.5, 3.9]]), ("tour", {}, [[4.5, 3.6], [2.5, 4.1]]), ("explore", {}, []),
    ("goal", {"goal": (3.5, 3.2)}, [[3.5, 3.2]]),
    ("tour", {"tour": ((3.4, 3.2), (4.1, 3.3)), "start": (2.1, 3.1, -0.4), "robot": {"radius": 0.15}},
     [[3.4, 3.2], [4.1, 3.3]]),
])  # fmt: skip
def test_a_mission_has_what_the_configuration_says_and_else_what_the_scene_says(
    tmp_path: Path, task: str, given: dict, goals: list
) -> None:
    scene = load_scene(write(tmp_path, "hall.toml", GOOD + ROOM))
    config, found = mission_of(preset(task=task, scene="rectangle", **given), scene)
    assert found.goals.tolist() == goals and found.walkers is None and config.people is None
    assert found.start == Pose(*given.get("start", (2.3, 3.4, 0.7)))
    assert found.radius_m == (0.15 if "start" in given else 0.2)


@pytest.mark.parametrize(("given", "said"), [
    ({"task": "explore", "goal": (3.5, 3.2)}, "goal: found with `task` explore"),
    ({"task": "goal", "tour": ((3.5, 3.2),)}, "tour: found with `task` goal"),
    ({"start": (1.7, 3.4, 0.3)}, "start: found (1.7, 3.4), 0.2 m from a wall, allowed: more than the robot's"),
    ({"start": (9.7, 3.4, 0.3)}, "start: found (9.7, 3.4), outside the region, allowed: x 1.6 to 5.4, y 2.8 to 4.3"),
    ({"task": "goal", "robot": {"radius": 0.7}}, "goal: found (4.5, 3.9), 0.6 m from a wall"),
    ({"task": "goal", "world": {"walkers": 90}}, "world.walkers: found 90, allowed: at most "),
])  # fmt: skip
def test_a_mission_that_cannot_be_is_refused_by_its_field(tmp_path: Path, given: dict, said: str) -> None:
    with pytest.raises(InputError) as caught:
        mission_of(preset(scene=str(write(tmp_path, "hall.toml", GOOD + ROOM)), **given))
    assert said in str(caught.value)


def test_a_flat_whose_door_is_narrow_is_known_by_the_share_of_its_rooms() -> None:
    parts = np.array([[[2.5, 0.0], [2.5, 2.6]], [[2.5, 2.9], [2.5, 6.0]]])
    walls = np.concatenate([np.array(SQUARE, dtype=np.float64), parts])
    scene = Scene("flat", walls, Pose(1.1, 0.9, 0.4), 0.18, None, ((1.3, 4.1), (4.9, 2.2)), (0, 0, 6, 6))
    assert unreachable(scene) == "tour, entry 2, 59% of the rooms: cannot be reached by a robot of 0.18 m"
    mission_of(preset(task="explore"), scene)
    with pytest.raises(InputError, match=r"tour, entry 2: found \(4.9, 2.2\), which no way leads to"):
        mission_of(preset(task="tour"), scene)


def test_clearances_are_exact_and_reached_cells_are_those_that_a_flood_fills() -> None:
    for seed in range(20):
        rng, reach = np.random.default_rng(seed), 0.6
        walls = rng.uniform(-1, 4, (5, 2, 2))
        walls[0, 1] = walls[0, 0]
        grid = SceneGrid(walls, np.array([-0.3, 0.2]), np.array([2.9, 2.5]), 0.17, reach)
        cells = np.argwhere(np.ones(grid.clearance_m.shape))
        plain = np.array([point_segment_distance(c, walls).min() for c in grid.centres(cells)])
        found = grid.clearance_m.ravel()
        assert np.allclose(found[plain < reach], plain[plain < reach]) and (found[plain >= reach] >= reach).all()
        free, at = grid.clearance_m > 0.15, rng.uniform(0.1, 2.5, 2)
        first, filled = grid.nearest(free, at), np.zeros_like(free)
        every = np.linalg.norm(grid.centres(np.argwhere(free)) - at, axis=1)
        assert np.hypot(*(grid.centres(np.array(first)) - at)) == pytest.approx(every.min())
        filled[first] = True
        assert np.array_equal(grid.reachable(free, at), ndimage.binary_propagation(filled, mask=free))
        assert not grid.reachable(free, at, 0.9 * every.min()).any()
