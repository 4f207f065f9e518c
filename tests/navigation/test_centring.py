"""A path through a gap that hardly lets the robot pass leads through its middle."""

import math

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.navigation.centring import centred
from sixthsense.running.runs import QUIET, simulate
from sixthsense.simulation.scene import Scene
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid

CELL_M, RADIUS_M = 0.05, 0.2


class Walls(Grid):
    """A grid that knows where its obstacles are."""

    def __init__(self, points: np.ndarray) -> None:
        super().__init__(preset("default").grid, RADIUS_M)
        self.points = points

    def obstacle_points(self, box: object) -> np.ndarray:
        return self.points


def space(*blocked: tuple[int, int]) -> FreeSpace:
    cells = np.zeros((80, 80), dtype=np.bool_)
    for row, col in blocked:
        cells[row, col] = True
    return FreeSpace(cells, ~cells, (-1.0, -1.0), CELL_M)


@pytest.mark.parametrize("angle", [0.0, 0.35, -1.1])
@pytest.mark.parametrize("off_m", [0.024, -0.031])
def test_a_path_is_moved_to_the_middle_of_a_corridor(angle: float, off_m: float) -> None:
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    along = np.arange(0.0, 1.5, 0.03)
    sides = [np.column_stack([along, np.full_like(along, side)]) for side in (-0.247, 0.253)]  # its middle is at 3 mm
    path = np.array([[0.113, off_m], [1.317, off_m]]) @ turn.T
    found = centred(Walls(np.concatenate(sides) @ turn.T), space(), path)
    assert found is not None
    assert found[0] == pytest.approx(path[0]) and found[-1] == pytest.approx(path[-1])
    assert np.abs((found @ turn)[1:-1, 1] - 0.003).max() < 0.004


def test_a_path_is_moved_off_an_obstacle_on_one_side_and_stays_where_there_is_room() -> None:
    path = np.array([[0.1, 0.02], [1.3, 0.02]])
    far, near = (np.column_stack([np.arange(0.0, 1.5, 0.03), np.full(50, y)]) for y in (0.28, 0.24))
    assert centred(Walls(far), space(), path) is None
    found = centred(Walls(near), space(), path)
    assert found is not None
    assert (found[1:-1, 1] < -0.01).all()  # 0.25 m off: the radius and the clearance


def test_a_path_is_not_moved_onto_a_blocked_cell() -> None:
    along = np.arange(0.0, 1.5, 0.03)
    points = np.concatenate([np.column_stack([along, np.full_like(along, side)]) for side in (-0.19, 0.33)])
    path = np.array([[0.1, 0.04], [1.3, 0.04]])
    assert centred(Walls(points), space(), path) is not None
    assert centred(Walls(points), space((21, 34)), path) is None  # the cell at (0.725, 0.075)


@pytest.mark.parametrize("seed", [2, 3])
def test_a_path_that_is_centred_at_each_keyframe_neither_grows_nor_folds_back(seed: int) -> None:
    """A bend between walls, of which each look has another noise, before a robot that stands."""
    rng = np.random.default_rng(seed)
    along, far = np.arange(0.0, 1.2, 0.03), np.arange(0.0, 0.7, 0.03)
    outer = [(x, 0.0) for x in along] + [(1.2, y) for y in along]
    inner = [(x, 0.49) for x in far] + [(0.71, 0.49 + y) for y in far]
    walls, path = np.array([*outer, *inner]), np.array([[0.1, 0.21], [0.93, 0.23], [0.94, 1.15]])
    for _ in range(80):
        found = centred(Walls(walls + rng.normal(0.0, 0.01, walls.shape)), space(), path)
        path = path if found is None else found
        steps = np.diff(path, axis=0)
        assert len(path) < 60 and np.hypot(*steps.T).sum() < 1.8
        assert np.count_nonzero(np.sum(steps[1:] * steps[:-1], axis=1) < 0.0) <= 1  # where the robot is off the middle


def corridor(width_m: float) -> Scene:
    """Two rooms and a corridor of 1.3 m between them, at an angle to the cells."""
    half, length, (depth, height) = 0.5 * width_m, 1.3, (2.1, 1.7)
    left = [(0.0, half), (0.0, height), (-depth, height), (-depth, -height), (0.0, -height), (0.0, -half)]
    right = [(length - x, -y) for x, y in left]
    corners = np.array([*left, *right])
    angle = 0.17
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    corners = corners @ turn.T + (0.013, 0.031)
    walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    low, high = corners.min(axis=0) - 0.1, corners.max(axis=0) + 0.1
    start = Pose(*(np.array([-1.2, 0.4]) @ turn.T), 0.4)
    return Scene("corridor", walls, start, RADIUS_M, None, (), (*low.tolist(), *high.tolist()))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_corridor_that_leaves_five_centimetres_on_either_side_is_driven(seed: int) -> None:
    found = simulate(preset("default", task="explore", seed=seed, max_time=300.0), corridor(0.5), watch=QUIET)
    assert found.outcome == "explored"
    assert found.metrics["coverage"] > 0.995 and found.metrics["collisions"] == 0


def test_a_corridor_narrower_than_the_robot_is_left_and_its_width_is_said() -> None:
    found = simulate(preset("default", task="explore", seed=7, max_time=300.0), corridor(0.39), watch=QUIET)
    assert found.outcome == "explored in part"
    assert np.array(found.trace.truths)[:, 0].max() < 0.5 and found.metrics["collisions"] == 0
    assert found.trace.left[0].gap_m == pytest.approx(0.39, abs=0.03)
