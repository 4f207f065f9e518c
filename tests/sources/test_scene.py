import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.sources.campus import Campus, campus_walls
from sixthsense.sources.mission import connected, mission
from sixthsense.sources.ros_map import outline_corners
from sixthsense.sources.scene import Scene, SceneError, check_placement, load_scene, shipped_scenes

SHIPPED = ["apartment", "block", "campus", "loop", "office", "rectangle"]
GOOD = "start = [1, 1, 0]\nradius = 0.2\ngoal = [3, 1]\ntour = [[3, 1], [1, 1]]\nregion = [0, 0, 4, 2]\n"
ROOM = "walls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]\n"
SMALL = Campus((3, 2), 27.0, 3.0, 0.3, 1.0, 4)
CELL_M = 0.1
SQUARE = [[[0, 0], [6, 0]], [[6, 0], [6, 6]], [[6, 6], [0, 6]], [[0, 6], [0, 0]]]
SHAFT = [[[3, 3], [4.5, 3]], [[4.5, 3], [4.5, 4.5]], [[4.5, 4.5], [3, 4.5]]]
MAP = {
    "image": "m.png",
    "resolution": "0.1",
    "origin": "[0, 0, 0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def write_map(folder: Path, pixels: np.ndarray, image: str = "m.png", **fields: str) -> Path:
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / image)
    table = {**MAP, "image": image, **fields}
    return write(folder, "m.yaml", "".join(f"{k}: {v}\n" for k, v in table.items()))


def sides(scene: Scene) -> set[tuple[tuple[float, float], ...]]:
    return {tuple(sorted(map(tuple, np.round(wall, 9) + 0.0))) for wall in scene.walls}


# --- the shipped scenes


def test_the_shipped_scenes_are_listed_by_name() -> None:
    assert list(shipped_scenes()) == SHIPPED
    assert load_scene("campus").region == (0.0, 0.0, 303.0, 303.0)


@pytest.mark.parametrize("name", SHIPPED)
def test_no_ray_leaks_out_of_a_scene(name: str) -> None:
    scene = load_scene(name)
    for place in [tuple(scene.start.position), scene.goal, *scene.tour]:
        ranges = cast_rays(Pose(*place, 0.1), np.linspace(-math.pi, math.pi, 1441), scene.walls, 1000.0)
        x0, y0, x1, y1 = scene.region
        assert ranges.max() <= math.hypot(x1 - x0, y1 - y0)


# --- loading


def test_walls_and_polygons_give_the_same_segments(tmp_path: Path) -> None:
    polygon = "[[polygons]]\npoints = [[0, 0], [4, 0], [4, 2], [0, 2]]\n"
    a = load_scene(write(tmp_path, "a.toml", GOOD + ROOM))
    b = load_scene(write(tmp_path, "b.toml", GOOD + polygon))
    c = load_scene(str(write(tmp_path, "c.toml", GOOD + polygon + "closed = false\n")))
    assert sides(a) == sides(b) and len(c.walls) == 3 and sides(c) < sides(b)
    assert (a.name, a.radius, a.goal, a.tour, a.region) == ("a", 0.2, (3, 1), ((3, 1), (1, 1)), (0, 0, 4, 2))
    assert a.start == Pose(1, 1, 0)
    assert a.walls.dtype == np.float64 and not a.walls.flags.writeable


# --- start and goal from outside


def test_a_placement_is_checked_against_the_scene() -> None:
    scene = load_scene("apartment")
    check_placement(scene)
    check_placement(scene, (1.0, 5.0, 3.0), (13.0, 5.0), (0, 0, 14, 9), 0.25)
    for given, said in [
        (
            {"start": (0.05, 5.0, 0.0)},
            "start: found (0.05, 5), 0.05 m from a wall, allowed: at least the robot's radius 0.18 m",
        ),
        ({"start": Pose(0.2, 5.0), "radius": 0.3}, "0.2 m from a wall, allowed: at least the robot's radius 0.3 m"),
        ({"start": (1.0, 2.0)}, "start: found (1.0, 2.0), allowed: 3 numbers"),
        ({"start": (math.nan, 2.0, 0.0)}, "start: found (nan, 2.0, 0.0)"),
        ({"goal": (15.0, 5.0)}, "goal: found (15, 5), outside the region"),
        ({"goal": (5.0, 5.0), "region": (6.0, 0.0, 14.0, 9.0)}, "outside the region, allowed: x 6 to 14, y 0 to 9"),
        ({"goal": (2.0, 4.3)}, "goal: found (2, 4.3), 0.1 m from a wall"),
        ({"tour": [(1.0, 5.0), (0.0, 5.0)]}, "tour, entry 2: found (0, 5), 0 m from a wall"),
        ({"region": (6.0, 0.0, 5.0, 9.0)}, "region: found [6, 0, 5, 9]"),
        ({"radius": -1.0}, "radius: found -1.0"),
        ({"radius": 0.9}, "start: found (11.6, 0.8), 0.8 m from a wall"),
    ]:  # fmt: skip
        with pytest.raises(SceneError) as caught:
            check_placement(scene, **given)
        assert said in str(caught.value)


# --- the report's format


def test_a_scn_file_is_a_start_a_radius_and_walls(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, "r.scn", "0 0.5 1 0.1\r\n-2 -1 -2 1\n-2 1 2 1\n\n2 1 2 -1\n2 -1 -2 -1\n"))
    assert (scene.start, scene.radius, scene.goal, scene.tour) == (Pose(0, 0.5, 1), 0.1, None, ())
    assert scene.region == (-2, -1, 2, 1) and len(scene.walls) == 4


# --- maps


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
        for loop in np.split(corners.astype(np.float64), ends[:-1]):
            for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                steps = int(np.abs(b - a).sum())
                along = a + np.arange(steps + 1)[:, None] * np.sign(b - a)
                edges = [tuple(map(tuple, pair)) for pair in np.stack([along[:-1], along[1:]], axis=1)]
                assert not found & set(edges)
                found |= set(edges)
        padded = np.pad(occupied, 1)
        expected = set()
        for y, x in np.argwhere(padded):
            left, bottom = x - 1.0, y - 1.0
            right, top = left + 1, bottom + 1
            expected |= {((left, bottom), (right, bottom))} if not padded[y - 1, x] else set()
            expected |= {((right, bottom), (right, top))} if not padded[y, x + 1] else set()
            expected |= {((right, top), (left, top))} if not padded[y + 1, x] else set()
            expected |= {((left, top), (left, bottom))} if not padded[y, x - 1] else set()
        assert found == expected


def test_the_pose_of_a_map_is_that_of_map_server(tmp_path: Path) -> None:
    pixels = np.full((4, 6), 254)
    pixels[3, 1] = 0  # the bottom row
    scene = load_scene(write_map(tmp_path, pixels, resolution="0.5", origin="[10, 20, 0]"))
    assert scene.region == (10.5, 20.0, 11.0, 20.5)
    assert len(scene.walls) == 4 and scene.start is None and scene.goal is None and scene.radius == 0.2
    turned = load_scene(write_map(tmp_path, pixels, resolution="0.5", origin=f"[10, 20, {math.pi / 2}]"))
    assert turned.region == pytest.approx((9.5, 20.5, 10.0, 21.0))
    moved = Pose(10, 20, math.pi / 2) @ (scene.walls - [10, 20])
    assert np.allclose(np.sort(moved.reshape(-1, 2), axis=0), np.sort(turned.walls.reshape(-1, 2), axis=0))


def test_unknown_cells_are_walls_unless_they_are_said_to_be_free(tmp_path: Path) -> None:
    pixels = np.full((30, 30), 205)
    pixels[5:25, 5:25] = 254
    pixels[5, 5:25] = 0  # one wall of four was seen
    file = write_map(tmp_path, pixels, resolution="0.1")
    assert load_scene(file).region == pytest.approx((0.0, 0.0, 3.0, 3.0))
    inside = cast_rays(Pose(1.5, 1.5), np.linspace(-3.1, 3.1, 50), load_scene(file).walls, 10.0)
    assert inside.max() < 1.5
    assert load_scene(file, "free").region == pytest.approx((0.5, 2.4, 2.5, 2.5))


def test_the_same_pixels_give_the_same_walls_in_every_format(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    grey = rng.choice(np.array([0, 60, 120, 205, 254], np.uint8), (20, 30))
    expected = sides(load_scene(write_map(tmp_path, grey)))
    assert sides(load_scene(write_map(tmp_path, grey, image="m.pgm"))) == expected
    assert sides(load_scene(write_map(tmp_path, np.dstack([grey] * 3)))) == expected
    assert sides(load_scene(write_map(tmp_path, 255 - grey, negate="1"))) == expected
    assert sides(load_scene(write_map(tmp_path, grey, mode="scale", resolution="1e-1"))) == expected
    path = write_map(tmp_path, grey)
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "m.png")
    assert sides(load_scene(path)) == expected
    Image.fromarray(grey).convert("P").save(tmp_path / "m.png")
    assert sides(load_scene(path)) == expected
    ascii_pgm = f"P2\n# comment\n30 20\n255\n{' '.join(map(str, grey.ravel()))}\n"
    write(tmp_path, "m.pgm", ascii_pgm)
    assert (
        sides(load_scene(write(tmp_path, "n.yaml", path.read_text().replace("m.png", f"{tmp_path}/m.pgm")))) == expected
    )


# --- real files


def test_the_real_maps_load(data_dir: Path) -> None:
    files = sorted((data_dir / "maps").glob("*.yaml"))
    assert files
    for file in files:
        scene = load_scene(file)
        assert len(scene.walls) > 100 and np.isfinite(scene.walls).all()
        assert np.linalg.norm(scene.walls[:, 1] - scene.walls[:, 0], axis=1).min() > 0.01


def test_glass_is_solid_and_no_wall(tmp_path: Path) -> None:
    file = tmp_path / "glazed.toml"
    file.write_text(GOOD + ROOM + "glass = [[2, 0, 2, 0.5]]\n")
    scene = load_scene(file)
    assert len(scene.walls) == 4
    assert scene.glass.tolist() == [[[2.0, 0.0], [2.0, 0.5]]]
    assert len(scene.solid) == 5
    with pytest.raises(SceneError, match="goal"):
        check_placement(scene, goal=(2.1, 0.4))
    file.write_text(GOOD + ROOM + "glass = [[2, 0, 2]]\n")
    with pytest.raises(SceneError, match="glass, entry 1: found"):
        load_scene(file)
    with pytest.raises(SceneError, match="glass: expected shape"):
        Scene("s", scene.walls, None, 0.2, None, (), scene.region, glass=np.zeros((1, 4)))


# --- a campus that is drawn from a few numbers


def drawn(walls, size):
    """Cells that walls cross."""
    cells = np.zeros(np.round(np.array(size) / CELL_M).astype(int) + 2, dtype=bool)
    for a, b in np.array(walls):
        points = a + np.linspace(0.0, 1.0, int(np.hypot(*(b - a)) / 0.03) + 2)[:, None] * (b - a)
        cells[tuple(np.floor(points / CELL_M).astype(int).T)] = True
    return cells


def test_every_room_and_hall_is_reached_through_doors():
    cells = drawn(campus_walls(SMALL), (93.0, 63.0))
    areas, _ = ndimage.label(~cells[1:-2, 1:-2])
    sizes = np.bincount(areas.ravel())[1:] * CELL_M**2
    assert sizes.max() > 0.95 * 93.0 * 63.0 - 200.0  # without the walls
    assert np.sort(sizes)[-2] < 2.0  # the inside of furniture and pillars


def test_one_seed_is_one_campus_and_another_is_another():
    assert np.array_equal(campus_walls(SMALL), campus_walls(SMALL))
    assert not np.array_equal(campus_walls(SMALL), campus_walls(replace(SMALL, seed=5)))


# --- goals that no way leads to


@pytest.mark.parametrize(("gap", "is_reached"), [(0.0, False), (0.2, False), (0.45, True), (1.5, True)])
def test_a_shaft_is_reached_through_a_door_that_the_robot_fits_through(gap, is_reached):
    walls = np.array([*SQUARE, *SHAFT, [[3.0, 3.0 + gap], [3.0, 4.5]]], dtype=np.float64)
    assert connected(walls, np.array([1.0, 1.0]), np.array([[3.8, 3.8]]), 0.2).tolist() == [is_reached]


def test_goals_of_every_shipped_scene_are_reached():
    for name in SHIPPED:
        scene = load_scene(name)
        for task, given in (("goal", scene.goal), ("tour", scene.tour)):
            if given:
                mission(scene, preset(scene=name, task=task))


def test_a_goal_in_a_shaft_without_a_door_is_told_in_one_line(tmp_path):
    walls = [*SQUARE, *SHAFT, [[3, 3], [3, 4.5]]]
    rows = ", ".join(str([x for point in wall for x in point]) for wall in walls)
    (tmp_path / "shaft.toml").write_text(f"start = [1.0, 1.0, 0.0]\nradius = 0.2\nwalls = [{rows}]\n")
    config = preset(scene=str(tmp_path / "shaft.toml"), task="goal", goal=(3.8, 3.8))
    with pytest.raises(SceneError, match=r"goal: found \(3.8, 3.8\), which no way leads to from the start \(1, 1\)"):
        mission(load_scene(config.scene), config)
