import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sixthsense import Run, preset, run


def box(x0: float, y0: float, x1: float, y1: float) -> str:
    return f"[[polygons]]\npoints = [[{x0}, {y0}], [{x1}, {y0}], [{x1}, {y1}], [{x0}, {y1}]]\n"


def two_rooms(door_m: float) -> str:
    """Two rooms of 4 x 3 m with a door between them."""
    low, high = 1.5 - 0.5 * door_m, 1.5 + 0.5 * door_m
    walls = f"walls = [[4.0, 0.0, 4.0, {low}], [4.0, {high}, 4.0, 3.0]]\n"
    return f"start = [1.0, 1.0, 0.0]\nradius = 0.2\n{walls}" + box(0.0, 0.0, 8.0, 3.0)


L_SHAPE = """
start = [0.7, 0.7, 0.0]
radius = 0.2
[[polygons]]
points = [[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [2.0, 2.0], [2.0, 6.0], [0.0, 6.0]]
"""
DIAGONAL = """
start = [1.0, 0.0, 0.0]
radius = 0.2
walls = [[3.0, -1.5, 4.5, 0.5]]
[[polygons]]
points = [[0.0, 0.0], [3.0, -3.0], [7.0, 1.0], [4.0, 4.0]]
"""
PILLARS = "start = [0.6, 0.6, 0.0]\nradius = 0.2\n" + "".join(
    [box(0.0, 0.0, 6.0, 5.0), box(1.5, 1.5, 1.9, 1.9), box(4.0, 1.4, 4.5, 1.8), box(2.6, 3.2, 3.1, 3.6)]
)
OPEN = """
start = [0.0, 0.0, 0.0]
radius = 0.2
walls = [[-3.0, 2.0, 2.0, 2.5], [2.5, -2.0, 3.0, 1.0], [-3.0, -2.0, -2.0, 0.0]]
"""
ENCLOSED = "start = [0.0, 0.0, 0.0]\nradius = 0.2\nregion = [-5, -5, 5, 5]\n" + box(-0.3, -0.3, 0.3, 0.3)
EMPTY = "start = [0.0, 0.0, 0.0]\nradius = 0.2\nregion = [-3.0, -3.0, 3.0, 3.0]\nwalls = [[50.0, 50.0, 51.0, 50.0]]\n"
LONG = "start = [1.0, 1.0, 0.0]\nradius = 0.2\n" + box(0.0, 0.0, 9.0, 2.5)

SEEN_WHOLE = {
    "an L": (L_SHAPE, {}),
    "walls at an angle": (DIAGONAL, {}),
    "pillars": (PILLARS, {}),
    "no outer wall": (OPEN, {"explore": {"margin_m": 0.5}}),
    "an empty world": (EMPTY, {}),
    "an enclosure": (ENCLOSED, {"max_time": 60.0}),
    "more than the laser reaches": (LONG, {"laser": {"max_range": 2.5}}),
    "half a field of view": (L_SHAPE, {"laser": {"fov": math.pi, "beams": 180}}),
    "a narrow door": (two_rooms(0.8), {}),
}


def explored(folder: Path, scene: str, **changes: Any) -> Run:
    file = folder / "scene.toml"
    file.write_text(scene)
    given = {"estimator": "ekf-invariant", "features": {"landmarks": "both"}, "max_time": 400.0} | changes
    return run(preset(scene=str(file), **given))


@pytest.mark.parametrize("name", SEEN_WHOLE)
def test_all_visible_area_is_seen_and_the_robot_returns_home(name: str, tmp_path: Path) -> None:
    scene, changes = SEEN_WHOLE[name]
    made = explored(tmp_path, scene, **changes)
    metrics = made.metrics
    assert metrics["outcome"] == "explored"
    assert metrics["collisions"] == 0
    assert metrics["coverage"] >= 0.995
    assert metrics["home_error_m"] <= 0.2
    assert metrics["places_left"] == 0
    if name == "no outer wall":  # within the region and its margin
        positions = np.array(made.trace.truths)[:, :2]
        assert (positions > [-3.5, -2.5]).all() and (positions < [3.5, 3.0]).all()


def test_places_behind_a_door_that_is_narrower_than_the_robot_are_left_and_named(tmp_path: Path) -> None:
    made = explored(tmp_path, two_rooms(0.3))
    assert made.outcome == "explored in part" and made.metrics["collisions"] == 0
    assert {place.reason for place in made.trace.left} == {"unreachable"}
    low, high = sorted(made.trace.left, key=lambda place: place.y)  # beside the door, as far as no wall is known
    assert low.y < 0.0 and high.y > 3.0 and all(3.8 < place.x < 4.6 for place in (low, high))
    gap_m = made.trace.left[0].gap_m
    assert gap_m is not None and 0.25 <= gap_m <= 0.37  # the mean of a jamb's last cell is short of its end


@pytest.mark.parametrize("seed", range(2))
def test_a_door_that_only_the_clearance_closes_is_passed(seed: int, tmp_path: Path) -> None:
    """The door is 6 cm wider than the robot, which keeps 5 cm from obstacles on either side where there is room."""
    made = explored(tmp_path, two_rooms(0.46), seed=seed)
    assert made.outcome == "explored"
    assert np.array(made.trace.truths)[:, 0].max() > 3.85  # its disc is in the door, at 4
    assert made.metrics["coverage"] >= 0.995
    assert made.metrics["collisions"] == 0 and made.metrics["home_error_m"] <= 0.2


def test_without_the_guard_no_robot_passes_a_door_that_the_clearance_closes(tmp_path: Path) -> None:
    made = explored(tmp_path, two_rooms(0.46), safety={"guard": False})
    assert made.outcome == "explored in part" and made.trace.left[0].reason == "cut off by inflation only"


def test_only_the_region_asked_for_is_explored(tmp_path: Path) -> None:
    whole = explored(tmp_path, two_rooms(1.0))
    part = explored(tmp_path, two_rooms(1.0), region=(0.0, 0.0, 3.5, 3.0))
    assert part.outcome == whole.outcome == "explored"
    assert part.trace.path_length_m < 0.6 * whole.trace.path_length_m
    assert np.array(part.trace.truths)[:, 0].max() < 4.5


def test_the_part_of_a_region_that_is_visible_only_from_outside_is_seen(tmp_path: Path) -> None:
    # Two rooms side by side whose doors lead to a corridor behind; the region holds the near half of both.
    rooms = "start = [1.0, 1.0, 0.0]\nradius = 0.2\nregion = [0.0, 0.0, 6.0, 1.7]\n"
    rooms += "walls = [[3.0, 0.0, 3.0, 3.5], [0.0, 3.5, 1.0, 3.5], [2.0, 3.5, 4.0, 3.5], [5.0, 3.5, 6.0, 3.5]]\n"
    made = explored(tmp_path, rooms + box(0.0, 0.0, 6.0, 5.0))
    assert made.outcome == "explored" and made.metrics["coverage"] > 0.995
    assert np.array(made.trace.truths)[:, 1].max() > 3.5


def test_the_random_method_explores_the_whole_scene_and_one_seed_gives_one_exploration(tmp_path: Path) -> None:
    one, other = (explored(tmp_path, L_SHAPE, explorer="random") for _ in range(2))
    assert one.outcome == "explored" and one.metrics["coverage"] >= 0.995
    np.testing.assert_array_equal(one.trace.truths, other.trace.truths)


def test_a_robot_that_does_not_know_where_it_is_has_not_explored(tmp_path: Path) -> None:
    unsure = {"motion": {"slip_position_per_sqrt_m": 0.5}}
    blind = {"lines": {"min_points": 300}, "points": {"min_points": 300}}
    made = explored(tmp_path, two_rooms(1.0), assumed=unsure, features=blind, explore={"loop_closure": False})
    assert made.outcome == "lost"


def test_without_the_return_home_it_ends_away_from_the_start(tmp_path: Path) -> None:
    made = explored(tmp_path, PILLARS, explore={"return_home": False})
    assert made.outcome == "explored"
    assert "home_error_m" not in made.metrics
    assert math.dist(made.trace.truths[-1][:2], made.trace.truths[0][:2]) > 0.5
    assert explored(tmp_path, PILLARS, max_time=3.0).outcome == "out of time"
