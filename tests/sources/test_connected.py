"""A goal that no way leads to is told before the drive."""

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.sources.mission import connected, mission
from sixthsense.sources.scene import SceneError, load_scene

ROOM = [[[0, 0], [6, 0]], [[6, 0], [6, 6]], [[6, 6], [0, 6]], [[0, 6], [0, 0]]]
SHAFT = [[[3, 3], [4.5, 3]], [[4.5, 3], [4.5, 4.5]], [[4.5, 4.5], [3, 4.5]]]
START, INSIDE = np.array([1.0, 1.0]), np.array([[3.8, 3.8]])


@pytest.mark.parametrize(("gap", "is_reached"), [(0.0, False), (0.2, False), (0.45, True), (1.5, True)])
def test_a_shaft_is_reached_through_a_door_that_the_robot_fits_through(gap, is_reached):
    walls = np.array([*ROOM, *SHAFT, [[3.0, 3.0 + gap], [3.0, 4.5]]], dtype=np.float64)
    assert connected(walls, START, INSIDE, 0.2).tolist() == [is_reached]


def test_goals_of_every_shipped_scene_are_reached():
    for name in ("rectangle", "block", "apartment", "office", "loop", "campus"):
        scene = load_scene(name)
        for task, given in (("goal", scene.goal), ("tour", scene.tour)):
            if given:
                mission(scene, preset(scene=name, task=task))


def test_a_goal_in_a_shaft_without_a_door_is_told_in_one_line(tmp_path):
    walls = [*ROOM, *SHAFT, [[3, 3], [3, 4.5]]]
    rows = ", ".join(str([x for point in wall for x in point]) for wall in walls)
    (tmp_path / "shaft.toml").write_text(f"start = [1.0, 1.0, 0.0]\nradius = 0.2\nwalls = [{rows}]\n")
    config = preset(scene=str(tmp_path / "shaft.toml"), task="goal", goal=(3.8, 3.8))
    with pytest.raises(SceneError, match=r"goal: found \(3.8, 3.8\), which no way leads to from the start \(1, 1\)"):
        mission(load_scene(config.scene), config)
