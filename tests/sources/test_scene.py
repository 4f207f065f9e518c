import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.core.ray_casting import cast_rays
from sixthsense.sources.outlines import _DEVIATION_COST, outlines, simplify
from sixthsense.sources.scene import Scene, SceneError, check_placement, load_scene, shipped_scenes

SHIPPED = ["apartment", "block", "campus", "loop", "office", "rectangle"]
DRAWN = [name for name in SHIPPED if name != "campus"]
"""those whose walls are in their file"""
CELL_M = 0.05
GOOD = "start = [1, 1, 0]\nradius = 0.2\ngoal = [3, 1]\ntour = [[3, 1], [1, 1]]\nregion = [0, 0, 4, 2]\n"
ROOM = "walls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]\n"
MAP = {
    "image": "m.png",
    "resolution": "0.1",
    "origin": "[0, 0, 0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


class Raster:
    """A scene's walls on a fine grid that reaches half a metre beyond its region."""

    def __init__(self, scene: Scene) -> None:
        x0, y0, x1, y1 = scene.region
        self.low = np.array([x0, y0]) - 0.5
        self.blocked = np.zeros((int((y1 - y0 + 1) / CELL_M) + 1, int((x1 - x0 + 1) / CELL_M) + 1), bool)
        for a, b in scene.walls:
            along = np.linspace(0.0, 1.0, int(np.linalg.norm(b - a) / CELL_M * 4) + 2)[:, None]
            self.blocked[tuple(self.cells(a + along * (b - a)).T)] = True

    def cells(self, points: np.ndarray) -> np.ndarray:
        return np.floor((np.asarray(points) - self.low) / CELL_M).astype(int)[..., ::-1]

    def reached(self, free: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The cells of `free` joined to the start by steps to the four neighbours."""
        labels, _ = ndimage.label(free)
        row, column = self.cells(start)
        assert free[row, column]
        return labels == labels[row, column]


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def write_map(folder: Path, pixels: np.ndarray, image: str = "m.png", **fields: str) -> Path:
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / image)
    table = {**MAP, "image": image, **fields}
    return write(folder, "m.yaml", "".join(f"{k}: {v}\n" for k, v in table.items()))


def fails(path: str | Path) -> str:
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


def sides(scene: Scene) -> set[tuple[tuple[float, float], ...]]:
    return {tuple(sorted(map(tuple, np.round(wall, 9) + 0.0))) for wall in scene.walls}


# --- the shipped scenes


def test_the_shipped_scenes_are_listed_by_name() -> None:
    assert list(shipped_scenes()) == SHIPPED


@pytest.mark.parametrize("name", DRAWN)
def test_no_path_leads_out_of_a_scene(name: str) -> None:
    scene = load_scene(name)
    raster = Raster(scene)
    inside = raster.reached(~raster.blocked, scene.start.position)
    rows, columns = np.nonzero(inside)
    x = raster.low[0] + (columns + 0.5) * CELL_M
    y = raster.low[1] + (rows + 0.5) * CELL_M
    x0, y0, x1, y1 = scene.region
    assert x0 <= x.min() and x.max() <= x1 and y0 <= y.min() and y.max() <= y1
    assert np.allclose(scene.region, [*scene.walls.min(axis=(0, 1)), *scene.walls.max(axis=(0, 1))])


@pytest.mark.parametrize("name", SHIPPED)
def test_no_ray_leaks_out_of_a_scene(name: str) -> None:
    scene = load_scene(name)
    for place in [tuple(scene.start.position), scene.goal, *scene.tour]:
        ranges = cast_rays(Pose(*place, 0.1), np.linspace(-math.pi, math.pi, 1441), scene.walls, 1000.0)
        x0, y0, x1, y1 = scene.region
        assert ranges.max() <= math.hypot(x1 - x0, y1 - y0)


@pytest.mark.parametrize("name", DRAWN)
def test_a_larger_robot_still_reaches_every_goal(name: str) -> None:
    scene = load_scene(name)
    raster = Raster(scene)
    clearance = ndimage.distance_transform_edt(~raster.blocked) * CELL_M
    reached = raster.reached(clearance >= scene.radius + 0.1, scene.start.position)
    for place in [scene.goal, *scene.tour]:
        assert reached[tuple(raster.cells(place))], place
        assert point_segment_distance(np.array(place), scene.walls).min() >= scene.radius + 0.15, place


@pytest.mark.parametrize("name", DRAWN)
def test_free_space_has_no_passage_too_narrow_for_a_robot_of_the_largest_radius(name: str) -> None:
    scene = load_scene(name)
    raster = Raster(scene)
    clearance = ndimage.distance_transform_edt(~raster.blocked) * CELL_M
    free = raster.reached(~raster.blocked, scene.start.position)
    core = raster.reached(free & (clearance >= 0.3), scene.start.position)
    # What a disc of 0.3 m cannot sweep are corners of rooms alone, no farther than sqrt(2) of it from its centre.
    assert (ndimage.distance_transform_edt(~core)[free] * CELL_M).max() <= 0.3 * math.sqrt(2) + 2 * CELL_M


def test_the_loop_has_about_a_hundred_metres_and_its_tour_goes_round_in_one_direction() -> None:
    scene = load_scene("loop")
    centre = np.array([16.0, 11.0])
    places = np.array([*scene.tour, scene.tour[0]]) - centre
    turns = np.diff(np.unwrap(np.arctan2(places[:, 1], places[:, 0])))
    assert (turns > 0).all() and turns.sum() == pytest.approx(2 * math.pi)
    lengths = np.linalg.norm(scene.walls[:, 1] - scene.walls[:, 0], axis=1)
    assert 95 < lengths.sum() / 2 < 105
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 25


def test_the_apartment_has_free_wall_ends() -> None:
    walls = load_scene("apartment").walls
    loose = 0
    for k, wall in enumerate(walls):
        others = np.delete(walls, k, axis=0)
        loose += sum(point_segment_distance(end, others).min() > 0.1 for end in wall)
    assert loose >= 20


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


def test_goal_tour_and_region_are_optional(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, "s.toml", "start = [1, 1, 0]\nradius = 0.2\n" + ROOM))
    assert scene.goal is None and scene.tour == () and scene.region == (0, 0, 4, 2)


def test_a_scene_keeps_its_own_copy_of_the_walls() -> None:
    walls = np.array([[[0, 0], [1, 0]]])
    scene = Scene("s", walls, None, 0.2, None, (), (0, 0, 1, 1))
    walls[:] = 7
    assert scene.walls[0, 1, 0] == 1.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (ROOM, "", "walls: found none"),
        (ROOM, "walls = []", "walls: found none"),
        (ROOM, "walls = 3", "walls: found 3, allowed: a list"),
        ("[4, 0, 4, 2]", "[4, 0, 4, 0]", "walls, entry 2: found a wall of no length at (4, 0)"),
        ("[4, 0, 4, 2]", "[4, 0, 4]", "walls, entry 2: found [4, 0, 4], allowed: 4 numbers (x1 y1 x2 y2)"),
        ("[4, 0, 4, 2]", "[4, 0, 4, nan]", "walls, entry 2: found [4, 0, 4, nan]"),
        ("[4, 0, 4, 2]", "[4, 0, 4, -inf]", "walls, entry 2"),
        ("[4, 0, 4, 2]", "[4, 0, 4, 1e300]", "walls, entry 2"),
        ("[4, 0, 4, 2]", f"[4, 0, 4, {10**400}]", "walls, entry 2"),
        ("[4, 0, 4, 2]", f"[4, 0, 4, {'1' * 5000}]", "not usable TOML"),
        ("[4, 0, 4, 2]", "[4, 0, 4, 'two']", "walls, entry 2"),
        ("[4, 0, 4, 2]", "[4, 0, 4, true]", "walls, entry 2"),
        ("[4, 0, 4, 2]", "5", "walls, entry 2"),
        ("radius", "raduis", "raduis: no such field, did you mean radius? allowed: start, radius, goal, tour, region"),
        ("radius = 0.2", "", "radius: missing"),
        ("radius = 0.2", "radius = 0", "radius: found 0, allowed: a number above 0"),
        ("radius = 0.2", "radius = -1.5", "radius: found -1.5"),
        ("radius = 0.2", "radius = nan", "radius: found nan"),
        ("radius = 0.2", "radius = 'big'", "radius: found 'big'"),
        ("start = [1, 1, 0]\n", "", "start: missing"),
        ("[1, 1, 0]", "[1, 1]", "start: found [1, 1], allowed: 3 numbers (x y theta)"),
        (
            "[1, 1, 0]",
            "[0.15, 1, 0]",
            "start: found (0.15, 1), 0.15 m from a wall, allowed: at least the robot's radius",
        ),
        ("[1, 1, 0]", "[9, 1, 0]", "start: found (9, 1), outside the region"),
        ("goal = [3, 1]", "goal = [3, 1.9]", "goal: found (3, 1.9), 0.1 m from a wall"),
        ("goal = [3, 1]", "goal = [3, 8]", "goal: found (3, 8), outside the region, allowed: x 0 to 4, y 0 to 2"),
        ("goal = [3, 1]", "goal = 3", "goal: found 3, allowed: 2 numbers (x y)"),
        ("[1, 1]]", "[1, 7]]", "tour, entry 2: found (1, 7), outside the region"),
        ("[1, 1]]", "[1, 0.1]]", "tour, entry 2: found (1, 0.1), 0.1 m from a wall"),
        ("tour = [[3, 1], [1, 1]]", "tour = [3, 1]", "tour, entry 1: found 3"),
        ("[0, 0, 4, 2]\n", "[4, 0, 0, 2]\n", "region: found [4, 0, 0, 2], allowed: x0 < x1 and y0 < y1"),
        ("[0, 0, 4, 2]\n", "[0, 0, 4]\n", "region: found [0, 0, 4]"),
        (ROOM, "polygons = 1", "polygons: found 1, allowed: a list"),
        (ROOM, "polygons = [1]", "polygons, entry 1: found 1, allowed: a table with points, closed"),
        (ROOM, "[[polygons]]\nclosed = false", "polygons, entry 1, points: missing"),
        (ROOM, "[[polygons]]\npoints = [[0, 0], [1, 0]]", "polygons, entry 1, points: found 2, allowed: at least 3"),
        (ROOM, "[[polygons]]\npoints = [[0, 0], [1, 0], 7]", "polygons, entry 1, point 3: found 7"),
        (
            ROOM,
            "[[polygons]]\npoints = [[0, 0], [1, 0], [0, 0]]",
            "polygons, entry 1, side 3: found a wall of no length",
        ),
        (ROOM, "[[polygons]]\npoints = [[0, 0], [1, 0], [0, 1]]\nclosed = 1", "polygons, entry 1, closed: found 1"),
        (
            ROOM,
            "[[polygons]]\npoint = [[0, 0]]",
            "polygons, entry 1, point: no such field, did you mean points? allowed: ",
        ),
        ("radius = 0.2", "radius = ", "is not TOML (Invalid value (at line 2"),
    ],
)
def test_an_invalid_toml_scene_gives_one_line_with_the_field(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD + ROOM
    path = write(tmp_path, "bad.toml", (GOOD + ROOM).replace(old, new, 1))
    message = fails(path)
    assert message.startswith(f"{path}: ") and said in message


def test_an_unknown_scene_lists_the_known_ones(tmp_path: Path) -> None:
    message = fails("appartment")
    assert "'appartment'" in message and all(name in message for name in SHIPPED)
    assert ".toml" in fails(tmp_path / "scene.json")


@pytest.mark.parametrize("name", ["none.toml", "none.yaml", "none.scn", "folder.toml"])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.toml").mkdir()
    assert fails(tmp_path / name).startswith(f"{tmp_path / name}: cannot be read (")


@pytest.mark.parametrize("name", ["a.toml", "a.yaml", "a.scn"])
def test_a_file_that_is_not_utf8_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"radius = \xff\xfe 1")
    assert "byte 9 is not UTF-8" in fails(tmp_path / name)


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


def test_a_scene_without_a_start_asks_for_one(tmp_path: Path) -> None:
    pixels = np.full((40, 40), 254)
    pixels[:, :20] = 0
    pixels[:, -1] = 0
    scene = load_scene(write_map(tmp_path, pixels))
    check_placement(scene, (3.0, 2.0, 0.0), (3.4, 2.0))
    with pytest.raises(SceneError, match="start: missing"):
        check_placement(scene)
    with pytest.raises(SceneError, match=r"start: found \(1, 2\), inside a wall, 1 m deep"):
        check_placement(scene, (1.0, 2.0, 0.0))


# --- the report's format


def test_a_scn_file_is_a_start_a_radius_and_walls(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, "r.scn", "0 0.5 1 0.1\r\n-2 -1 -2 1\n-2 1 2 1\n\n2 1 2 -1\n2 -1 -2 -1\n"))
    assert (scene.start, scene.radius, scene.goal, scene.tour) == (Pose(0, 0.5, 1), 0.1, None, ())
    assert scene.region == (-2, -1, 2, 1) and len(scene.walls) == 4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: missing"),
        ("0 0 0\n", "line 1: found [0.0, 0.0, 0.0], allowed: 4 numbers (x y theta radius)"),
        ("0 0 0 0.1\n", "line 2: missing"),
        ("0 0 0 0\n1 1 2 2\n", "line 1, radius: found 0.0"),
        ("0 0 0 0.1\n1 1 2 2\n\n1 1 two 2\n", "line 4: found [1.0, 1.0, 'two', 2.0]"),
        ("0 0 0 0.1\n1 1 2 nan\n", "line 2: found"),
        ("0 0 0 0.1\n1 1 2 2\n3 3 3 3\n", "line 3: found a wall of no length at (3, 3)"),
        ("0 0 0 0.1\n0 1 0 -1\n1 1 2 2\n", "start: found (0, 0), 0 m from a wall"),
        ("0 0 0 0.1\n1 1 1 2\n", "walls: all on one line"),
    ],
)
def test_an_invalid_scn_scene_gives_one_line_with_the_line_number(tmp_path: Path, text: str, said: str) -> None:
    assert said in fails(write(tmp_path, "bad.scn", text))


# --- maps


def random_images() -> list[np.ndarray]:
    images = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        image = rng.random((rng.integers(1, 25), rng.integers(1, 25)))
        image = ndimage.gaussian_filter(image, rng.choice([0.0, 0.7, 1.5]))
        images.append(image > np.quantile(image, rng.uniform(0.1, 0.9)))
    return images


def disc(radius: float, width: float, centre: float = 20.3) -> np.ndarray:
    y, x = np.mgrid[:42, :42] + 0.5
    distance = np.hypot(x - centre, y - centre + 0.4)
    return (distance > radius) & (distance <= radius + width)


def signed_area(loop: np.ndarray) -> float:
    x, y = loop.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_outlines_are_the_edges_between_occupied_and_free_cells() -> None:
    for occupied in random_images():
        found = set()
        for loop in outlines(occupied):
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


def test_each_obstacle_has_one_outer_outline_and_each_hole_another() -> None:
    for occupied in random_images():
        areas = np.array([signed_area(loop) for loop in outlines(occupied)])
        solids = ndimage.label(occupied, np.ones((3, 3)))[1]
        holes = ndimage.label(~np.pad(occupied, 1))[1] - 1
        assert ((areas > 0).sum(), (areas < 0).sum(), areas.sum()) == (solids, holes, occupied.sum())


def test_a_diagonal_pair_has_one_outline_and_an_empty_grid_none() -> None:
    assert len(outlines(np.eye(2, dtype=bool))) == 1
    assert len(outlines(np.eye(2, dtype=bool)[::-1])) == 1
    assert outlines(np.zeros((3, 3), bool)) == []


def test_every_corner_stays_within_half_a_cell_of_the_simplified_outline() -> None:
    for occupied in [*random_images(), *(disc(r, w) for r in (5.0, 11.3, 16.0) for w in (1.0, 1.5, 4.0))]:
        for loop in outlines(occupied):
            simple = simplify(loop)
            walls = np.stack([simple, np.roll(simple, -1, axis=0)], axis=1)
            assert 3 <= len(simple) <= len(loop)
            assert np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1).min() > 0.4
            assert max(point_segment_distance(corner, walls).min() for corner in loop) <= 0.5 + 1e-6


def test_simplification_keeps_rectangles_and_straightens_staircases() -> None:
    for height, width in [(1, 1), (1, 2), (1, 40), (3, 3), (2, 50)]:
        loop = outlines(np.ones((height, width), bool))[0]
        assert {tuple(p) for p in simplify(loop)} == {(0, 0), (width, 0), (width, height), (0, height)}
    y, x = np.mgrid[:60, :60]
    for slope in (0.1, 0.25, 0.5, 1.0, 2.0):  # others are staircases of uneven steps, too ragged for the bound
        loop = outlines(y < 60 - slope * x)[0]
        assert len(simplify(loop)) <= 12


def test_the_simplified_outline_has_the_least_cost() -> None:
    def cost(points: np.ndarray, i: int, j: int) -> float:
        """The price of the segment from point i to point j, by the definition."""
        along = points[j] - points[i]
        length = np.linalg.norm(along)
        passed = points[i + 1 + (i + 1) % 2 : j : 2] - points[i]
        if len(passed) == 0:
            return 1.0
        distances = np.linalg.norm(passed, axis=1)
        if length < distances.max() - 1e-12:
            return np.inf
        off = (along[0] * passed[:, 1] - along[1] * passed[:, 0]) / length
        far = distances > 0.5
        if (np.abs(off[far]) > 0.5 + 1e-8).any() or (passed[far] @ along < 0).any():
            return np.inf
        return 1.0 + _DEVIATION_COST * float(off @ off)

    checked = 0
    for occupied in random_images():
        for loop in outlines(occupied):
            if len(loop) > 24:
                continue
            points = np.stack([loop, (loop + np.roll(loop, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
            points = np.concatenate([points, points[:1]])
            best = [0.0]
            for j in range(1, len(points)):
                best.append(min(best[i] + cost(points, i, j) for i in range(j)))
            # A place visited twice has two indices: walk along the outline to find the kept ones.
            kept, k = [], 0
            for corner in simplify(loop):
                while (points[k] != corner).any():
                    k += 1
                kept.append(k)
            kept.append(len(points) - 1)
            total = sum(cost(points, i, j) for i, j in pairwise(kept))
            assert total == pytest.approx(best[-1])
            checked += 1
    assert checked > 100


def test_no_ray_passes_between_diagonal_cells(tmp_path: Path) -> None:
    for radius in np.linspace(4.0, 16.0, 13):
        occupied = disc(radius, 1.0)
        pixels = np.where(occupied, 0, 254)[::-1]
        scene = load_scene(write_map(tmp_path, pixels, resolution="1"))
        ranges = cast_rays(Pose(20.3, 19.9), np.linspace(-3.1, 3.1, 2000), scene.walls, 100.0)
        assert np.abs(ranges - radius - 0.5).max() < 1.5


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


def test_the_solid_is_on_the_left_of_the_walls_of_a_map(tmp_path: Path) -> None:
    pixels = np.full((30, 30), 254)
    pixels[5:25, 5:25] = 0
    pixels[10:20, 10:20] = 254
    walls = load_scene(write_map(tmp_path, pixels, origin="[3, -1, 0.7]")).walls
    x, y = walls[:, 0].T
    u, v = walls[:, 1].T
    assert len(walls) == 8 and 0.5 * (x * v - u * y).sum() == pytest.approx(4.0 - 1.0)


def test_unknown_cells_are_walls_unless_they_are_said_to_be_free(tmp_path: Path) -> None:
    pixels = np.full((30, 30), 205)
    pixels[5:25, 5:25] = 254
    pixels[5, 5:25] = 0  # one wall of four was seen
    file = write_map(tmp_path, pixels, resolution="0.1")
    assert load_scene(file).region == pytest.approx((0.0, 0.0, 3.0, 3.0))
    inside = cast_rays(Pose(1.5, 1.5), np.linspace(-3.1, 3.1, 50), load_scene(file).walls, 10.0)
    assert inside.max() < 1.5
    assert load_scene(file, "free").region == pytest.approx((0.5, 2.4, 2.5, 2.5))


def test_a_corridor_that_the_image_cuts_off_ends_in_a_wall(tmp_path: Path) -> None:
    pixels = np.full((30, 30), 0)
    pixels[10:20, 10:] = 254
    file = write_map(tmp_path, pixels, resolution="0.1")
    inside = cast_rays(Pose(2.5, 1.5), np.linspace(-3.1, 3.1, 50), load_scene(file).walls, 10.0)
    assert inside.max() < 2.0
    assert cast_rays(Pose(2.5, 1.5), np.array([0.0]), load_scene(file).walls, 10.0) == pytest.approx([0.5])
    assert cast_rays(Pose(2.5, 1.5), np.array([0.0]), load_scene(file, "free").walls, 10.0) == [np.inf]


def test_a_building_drawn_on_free_ground_stays_open(tmp_path: Path) -> None:
    pixels = np.full((30, 30), 254)
    pixels[0, 5:20] = pixels[10:20, 10:20] = 0
    scene = load_scene(write_map(tmp_path, pixels, resolution="0.1"))
    assert scene.region == pytest.approx((0.5, 1.0, 2.0, 3.0))


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


def test_alpha_is_averaged_in_trinary_maps_but_not_in_scale_maps(tmp_path: Path) -> None:
    pixels = np.full((3, 3, 4), 255)
    pixels[1, 1] = [0, 0, 0, 255]  # the mean with alpha is 64: occupancy 0.75
    assert len(load_scene(write_map(tmp_path, pixels)).walls) == 4
    assert "no occupied pixel" in fails(write_map(tmp_path, pixels, occupied_thresh="0.8", free_thresh="0.8"))
    scale = write_map(tmp_path, pixels, occupied_thresh="0.8", free_thresh="0.8", mode="scale")
    assert len(load_scene(scale).walls) == 4


def test_a_cell_exactly_at_the_threshold_is_not_occupied(tmp_path: Path) -> None:
    pixels = np.full((2, 2), 255)
    pixels[0, 0] = 51  # occupancy 0.8
    with pytest.raises(SceneError, match="no occupied pixel"):
        load_scene(write_map(tmp_path, pixels, occupied_thresh="0.8"), "free")
    assert len(load_scene(write_map(tmp_path, pixels, occupied_thresh="0.7999"), "free").walls) == 4


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"resolution": "0"}, "resolution: found 0"),
        ({"resolution": "-0.05"}, "resolution: found -0.05"),
        ({"resolution": ".nan"}, "resolution: found '.nan', allowed: a number"),
        ({"resolution": "[1]"}, "resolution: found ['1']"),
        ({"origin": "[0, 0]"}, "origin: found ['0', '0'], allowed: [x, y, yaw]"),
        ({"origin": "[0, 0, north]"}, "origin, entry 3: found 'north'"),
        ({"negate": "2"}, "negate: found '2', allowed: 0 or 1"),
        ({"occupied_thresh": "65"}, "occupied_thresh: found 65, allowed: 0 to 1"),
        ({"free_thresh": "low"}, "free_thresh: found 'low'"),
        ({"mode": "raw"}, "mode: found 'raw', allowed: trinary, scale"),
        ({"image": "[a, b]"}, "image: found ['a', 'b']"),
        ({"image": "nowhere.pgm"}, "nowhere.pgm: no such image file"),
        ({"image": '"a\\0b"'}, "not a readable image"),
        ({"occupied_tresh": "0.5"}, "occupied_tresh: no such field, did you mean occupied_thresh? allowed: image"),
        ({"resolution": ""}, "resolution: found ''"),
        ({"resolution": "[1, 2"}, "is not YAML ("),
        ({"image": "m.yaml"}, "m.yaml: not a readable image"),
    ],
)
def test_an_invalid_map_gives_one_line_with_the_field(tmp_path: Path, fields: dict[str, str], said: str) -> None:
    path = write_map(tmp_path, np.zeros((3, 3)))
    path.write_text("".join(f"{k}: {v}\n" for k, v in {**MAP, **fields}.items()), encoding="utf-8")
    message = fails(path)
    assert message.startswith(f"{path}: ") and said in message


@pytest.mark.parametrize("field", MAP)
def test_a_map_needs_every_field(tmp_path: Path, field: str) -> None:
    table = "".join(f"{k}: {v}\n" for k, v in MAP.items() if k != field)
    assert f"{field}: missing" in fails(write(tmp_path, "m.yaml", table))


def test_a_map_file_without_a_table_is_refused(tmp_path: Path) -> None:
    assert "allowed: a table" in fails(write(tmp_path, "m.yaml", "- 1\n- 2\n"))
    assert "allowed: a table" in fails(write(tmp_path, "m.yaml", ""))
    fails(write(tmp_path, "m.yaml", "[" * 100_000))


@pytest.mark.parametrize("image", ["m.png", "m.pgm"])
def test_a_truncated_image_is_refused(tmp_path: Path, image: str) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (50, 50))
    path = write_map(tmp_path, pixels, image=image)
    whole = (tmp_path / image).read_bytes()
    for length in (0, 1, 2, 7, 20, 40, len(whole) // 2, len(whole) - 40):
        (tmp_path / image).write_bytes(whole[:length])
        assert f"{image}: not a readable image" in fails(path)


@pytest.mark.parametrize("size", ["20000 20000", "9999 10002", "100000 100000", "1000000000 1000000000"])
def test_a_huge_image_is_refused_before_it_is_read(tmp_path: Path, size: str) -> None:
    path = write_map(tmp_path, np.zeros((2, 2)), image="m.pgm")
    write(tmp_path, "m.pgm", f"P5 {size} 255\n")
    assert "allowed: 100,000,000 " in fails(path)


# --- real files


def test_the_real_maps_load(data_dir: Path) -> None:
    files = sorted((data_dir / "maps").glob("*.yaml"))
    assert files
    for file in files:
        scene = load_scene(file)
        assert len(scene.walls) > 100 and np.isfinite(scene.walls).all()
        assert np.linalg.norm(scene.walls[:, 1] - scene.walls[:, 0], axis=1).min() > 0.01


def test_a_map_rotated_by_180_degrees_extends_left_and_below_its_origin(data_dir: Path) -> None:
    x0, y0, x1, y1 = load_scene(data_dir / "maps" / "stata_basement.yaml", "free").region
    width, height = 1730 * 0.0504, 1300 * 0.0504
    assert x1 <= 26.1 and x0 >= 25.9 - width - 0.2 and y1 <= 48.6 and y0 >= 48.5 - height - 0.2


def test_the_scenes_of_the_report_load(data_dir: Path) -> None:
    found = {file.stem: load_scene(file) for file in (data_dir / "scenes_report").glob("*.scn")}
    assert len(found.pop("market").walls) == 161
    assert {name: len(scene.walls) for name, scene in found.items()} == {
        "apartment": 65,
        "simple_block": 8,
        "simple_rectangle": 4,
    }
    assert found["apartment"].start == Pose(12.5, 1.6, 1.57) and found["simple_block"].radius == 0.2


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
