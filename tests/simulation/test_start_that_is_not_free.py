"""A start in furniture or in a wall is refused, with the nearest free place."""

import re

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.config import merge, preset
from sixthsense.config.errors import InputError
from sixthsense.simulation.mission import mission_of

SCENE = """\
start = [{start}]
radius = 0.2
[[polygons]]
points = [[-1.3, -0.9], [8.1, -0.9], [8.4, 6.2], [-1.0, 5.9]]
[[polygons]]  # a table of 1.6 m by 1.4 m
points = [[3.1, 2.2], [4.7, 2.3], [4.6, 3.7], [3.0, 3.6]]
[[polygons]]  # a hollow wall, whose inside is wide enough for the robot
points = [[-1.0, 4.3], [1.2, 4.3], [1.2, 5.0], [-1.0, 5.0]]
"""


def started(folder, start):
    file = folder / "scene.toml"
    file.write_text(SCENE.format(start=start))
    return mission_of(merge(preset("default"), {"scene": str(file)}))


@pytest.mark.parametrize(("start", "words"), [
    ("3.9, 3.0, 0.4", "inside a table"), ("0.3, 4.65, 1.1", "inside a table"), ("3.2, 2.3, 0.4", "m from a wall"),
])  # fmt: skip
def test_a_start_that_is_not_free_is_refused_with_the_nearest_place_that_is(tmp_path, start, words):
    with pytest.raises(InputError, match=words) as error:
        started(tmp_path, start)
    place = np.array([float(word) for word in re.findall(r"such as \(([-\d.]+), ([-\d.]+)\)", str(error.value))[0]])
    x, y, _ = map(float, start.split(","))
    assert np.hypot(*(place - (x, y))) < 1.2
    started(tmp_path, f"{place[0]}, {place[1]}, 0.7")


def test_a_start_beside_the_table_is_taken(tmp_path):
    _, task = started(tmp_path, "2.6, 2.9, -0.7")
    assert (task.start.x, task.start.y) == (2.6, 2.9)


def test_a_hall_without_a_door_beside_a_larger_one_is_no_furniture(tmp_path):
    file = tmp_path / "halls.toml"
    file.write_text(
        "start = [1.1, 0.9, 0.4]\nradius = 0.2\n[[polygons]]\n"
        "points = [[0.0, -0.2], [4.0, 0.0], [4.0, 3.0], [0.0, 3.1]]\n[[polygons]]\n"
        "points = [[4.0, 0.0], [12.0, 0.0], [12.0, 5.0], [4.0, 3.0]]\n"
    )
    run = ss.run(file, max_time=1.0, progress=False)
    assert run.outcome == "explored"  # all of the hall is seen from its start
