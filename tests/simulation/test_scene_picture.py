"""A scene is drawn as it is."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from sixthsense.cli import main
from sixthsense.core.geometry import Pose
from sixthsense.simulation.scene import Scene, load_scene
from sixthsense.simulation.walking_space import ScriptedWalk

SCENE = Scene(
    "hall", [[[-3.1, 2.2], [4.7, 2.6]], [[4.7, 2.6], [5.9, -1.3]]], Pose(1.2, 0.7, 2.1), 0.31, (3.3, 1.9),
    ((0.4, 1.6), (2.5, -0.8)), (-2.7, -1.9, 5.2, 3.4), glass=[[[0.3, 1.1], [0.9, 1.7]]],
    walkers=(ScriptedWalk(points=((1.5, 2.1), (-1.4, 0.6)), speed=0.7, pauses=(2.0, 3.0)),),
)  # fmt: skip


def test_a_picture_of_a_scene_has_its_walls_glass_start_goals_and_people_where_they_are() -> None:
    (ax,) = SCENE.plot().axes
    walls, glass = (c for c in ax.collections if isinstance(c, LineCollection))
    assert np.array_equal(walls.get_segments(), SCENE.walls) and np.array_equal(glass.get_segments(), SCENE.glass)
    lines = {line.get_label(): np.array(line.get_xydata()) for line in ax.lines}
    assert lines["tour"].tolist() == [[0.4, 1.6], [2.5, -0.8]] and lines["goal"].tolist() == [[3.3, 1.9]]
    assert lines["people"].tolist() == [[1.5, 2.1], [-1.4, 0.6]]
    region, robot = ax.patches[:2]
    assert region.get_bbox().extents.tolist() == pytest.approx(SCENE.region)
    assert (*robot.center, robot.radius) == (1.2, 0.7, 0.31)
    (arrow,) = (text for text in ax.texts if not text.get_text())
    assert arrow.xy == pytest.approx((1.2 + 0.62 * math.cos(2.1), 0.7 + 0.62 * math.sin(2.1)))
    assert {text.get_text(): text.xy for text in ax.texts if text.get_text()} == {"1": (0.4, 1.6), "2": (2.5, -0.8)}


def test_a_scene_is_told_in_a_line() -> None:
    told = "hall: 7.9 x 5.3 m, 2 walls, 1 of glass, 2 goals on the tour, 1 walking"
    assert SCENE.summary() == told and repr(SCENE) == f"<Scene {told}>"


def test_the_command_draws_a_scene_and_lists_the_shipped_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["scenes", "rectangle"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == load_scene("rectangle").summary()
    assert Path("runs/scenes/rectangle.png").read_bytes().startswith(b"\x89PNG")
    assert main(["scenes", "rectangel"]) == 2 and main(["scenes"]) == 0
    assert load_scene("office").summary() in capsys.readouterr().out.splitlines()
