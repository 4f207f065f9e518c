"""No robot drives to and fro: the way of an exploration is bounded by the walls that there are to see."""

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.running.runs import QUIET, simulate
from sixthsense.simulation.scene import Scene

WAY_PER_WALL = 1.0
"""A robot that goes along every wall once drives their length. A tour through the rooms drives less, .6 of it in these
houses, since a wall is seen from metres away; one that goes to and fro drives any multiple of it."""
RADIUS_M = 0.2
LEAST_ROOM_M, DOORS_M = 2.0, (0.52, 1.1)


def divided(rng: np.random.Generator, x0: float, y0: float, x1: float, y1: float) -> list[Array]:
    """The walls (2, 2) that divide a room again and again, each with a door; many doors hardly let the robot pass."""
    if max(x1 - x0, y1 - y0) < 2.0 * LEAST_ROOM_M or rng.random() < 0.1:
        return []
    across = x1 - x0 > y1 - y0
    low, high, begin, end = (x0, x1, y0, y1) if across else (y0, y1, x0, x1)
    at, door_m = rng.uniform(low + LEAST_ROOM_M, high - LEAST_ROOM_M), rng.uniform(*DOORS_M)
    door = rng.uniform(begin + 0.3, end - 0.3 - door_m)
    walls = [np.array([[at, begin], [at, door]]), np.array([[at, door + door_m], [at, end]])]
    if across:
        return [*walls, *divided(rng, x0, y0, at, y1), *divided(rng, at, y0, x1, y1)]
    return [*(wall[:, ::-1] for wall in walls), *divided(rng, x0, y0, x1, at), *divided(rng, x0, at, x1, y1)]


def house(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    width, height = rng.uniform(6.0, 10.0, 2)
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    outer = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    walls = np.array([*outer, *divided(rng, 0.0, 0.0, width, height)])
    start = Pose(0.7 + 0.3 * rng.random(), 0.8 + 0.2 * rng.random(), rng.uniform(-3.0, 3.0))
    return Scene(f"house {seed}", walls, start, RADIUS_M, None, (), (0.0, 0.0, float(width), float(height)))


def length_m(walls: Array) -> float:
    return float(np.hypot(*(walls[:, 1] - walls[:, 0]).T).sum())


@pytest.mark.parametrize("seed", range(8))
def test_the_way_is_bounded_by_the_walls_of_a_house(seed: int) -> None:
    scene = house(seed)
    bound_m = WAY_PER_WALL * (length_m(scene.walls) + 1.0)
    # Twice the time for the bound at full speed: so that a robot that goes to and fro fails by its way.
    config = preset("default", task="explore", seed=seed, max_time=4.0 * bound_m + 120.0)
    found = simulate(config, scene, watch=QUIET)
    assert found.metrics["outcome"] in ("explored", "explored in part")
    assert found.metrics["path_length_m"] <= bound_m
    assert found.metrics["collisions"] == 0
