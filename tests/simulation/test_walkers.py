"""People in the simulated building: where they go, what the laser sees of them, and whom they touch."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scanned import box
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.simulation.scene import Scene, load_scene, walking_grid
from sixthsense.simulation.scene_files import ScriptedWalk
from sixthsense.simulation.scene_grid import _shortest
from sixthsense.simulation.walkers import Walkers
from sixthsense.simulation.world import World

CORNER = np.array([-2.3, 3.4])  # of the building, whose places are stated from there
HALL = CORNER + box(0.0, 0.0, 8.0, 4.0)
DIVIDED = np.concatenate([HALL, CORNER + np.array([[[4.0, 0.0], [4.0, 1.5]], [[4.0, 2.5], [4.0, 4.0]]])])
WALLED = np.concatenate([HALL, CORNER + np.array([[[4.0, 0.0], [4.0, 4.0]]])])
REGION = (-2.3, 3.4, 5.7, 7.4)
AWAY = Pose(100.0, 100.0, 0.7)


def at(x: float, y: float, theta: float = 0.7) -> Pose:
    return Pose(x + CORNER[0], y + CORNER[1], theta)


def walkers(*walks: ScriptedWalk, walls: Array = HALL, start: Pose = AWAY, seed: int = 1, **world: object) -> Walkers:
    scene = Scene("hall", walls, start, 0.2, None, (), REGION, walkers=walks)
    return Walkers(scene, preset(world=world, seed=seed), start, 0.2)


def walk(*points: tuple[float, float], speed: float = 1.3, pauses: tuple[float, ...] | None = None) -> ScriptedWalk:
    return ScriptedWalk(points=[at(*point).position.tolist() for point in points], speed=speed, pauses=pauses)


def tracks(people: Walkers, seconds: float, robot: Pose = AWAY) -> Array:
    """(S, N, 2) where they are, every tick of 0.02 s, beside a robot that stands."""
    found = []
    for _ in range(round(seconds / 0.02)):
        people.step(robot, robot, 0.02)
        found.append(people.at - CORNER)
    return np.array(found)


def test_a_way_is_as_short_as_dijkstras() -> None:
    grid, free = walking_grid(Scene("hall", DIVIDED, AWAY, 0.2, None, (), REGION))
    number, ends, costs = np.arange(free.size).reshape(free.shape), [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):  # no cell at the border is free
        joined = free & np.roll(free, (-down, -across), (0, 1))
        joined &= np.roll(free, -across, 1) & np.roll(free, -down, 0)
        ends.append(np.stack([number[joined], np.roll(number, (-down, -across), (0, 1))[joined]]))
        costs.append(np.full(np.count_nonzero(joined), np.hypot(down, across)))
    graph = coo_array((np.concatenate(costs), np.hstack(ends)), shape=(free.size, free.size)).tocsr()
    rng = np.random.default_rng(0)
    for first, last in np.argwhere(free)[rng.integers(np.count_nonzero(free), size=(8, 2))]:
        cells = _shortest(free, tuple(first.tolist()), tuple(last.tolist()))
        assert np.array_equal(cells[[0, -1]], [first, last]) and free[tuple(cells.T)].all()
        shortest = dijkstra(graph, directed=False, indices=number[tuple(first)])[number[tuple(last)]]
        assert np.hypot(*np.diff(cells, axis=0).T).sum() == pytest.approx(shortest, abs=1e-6)
        start, goal = grid.centres(np.array([first, last]))
        way = grid.way(free, start, goal)
        assert np.array_equal(way[[0, -1]], [start, goal]) and len(way) <= 4  # straight but for the door
        assert math.dist(start, goal) - 1e-9 <= np.hypot(*np.diff(way, axis=0).T).sum() <= 0.1 * shortest + 1e-9
    divided, apart = walking_grid(Scene("halls", WALLED, AWAY, 0.2, None, (), REGION))
    assert divided.way(apart, at(1.0, 1.0).position, at(7.0, 1.0).position).shape == (0, 2)


def test_walks_that_cannot_be_are_refused_by_their_point(tmp_path: Path) -> None:
    text = f"start = [-1.3, 4.4, 0.3]\nradius = 0.2\nwalls = {WALLED.reshape(-1, 4).tolist()}\n"
    for walk_text, said in (
        ("points = [[-1.3, 4.4], [2.7, 4.4]]", r"entry 1, point 2: found \(2.7, 4.4\), to which no way leads"),
        ("points = [[-1.3, 4.4], [1.57, 4.4]]", r"entry 1, point 2: found \(1.57, 4.4\), to which no way"),
        ("points = [[-1.3, 4.4], [1.0, 5.0]]\npauses = [2.0]", "entry 1, pauses: found 1, allowed: a time for each"),
        ("points = []\nspeed = 2.5", r"entry 1, points: found \(\)"),
        ("\n[[walkers]]\n".join(["points = [[-1.3, 4.4]]"] * 201), "walkers: Tuple should have at most 200 items"),
    ):
        file = tmp_path / "walked.toml"
        file.write_text(f"{text}[[walkers]]\n{walk_text}\n")
        with pytest.raises(InputError, match=said):
            load_scene(file)


def test_a_scripted_walk_has_its_speed_and_its_pause_at_each_point() -> None:
    people = walkers(walk((1.0, 2.0), (3.0, 2.0), (3.0, 3.5), speed=1.6, pauses=(0.8, 1.5, 2.7)))
    found = tracks(people, 14.0)[:, 0]
    speeds = np.linalg.norm(np.diff(found, axis=0), axis=1) / 0.02
    assert np.unique(speeds.round(6)).tolist() == pytest.approx([0.0, 1.6])
    standing = np.concatenate([[0], np.flatnonzero(np.diff((speeds > 0.0).astype(int))) + 1])
    spans = np.diff(standing) * 0.02
    assert spans[0] == pytest.approx(0.8, abs=0.25)
    stood = [span for span, k in zip(spans, standing, strict=False) if not speeds[k]]
    assert stood[1:4] == pytest.approx([1.5, 2.7, 0.8], abs=0.25)


def test_two_people_who_meet_pass_each_other_on_the_right() -> None:
    people = walkers(walk((1.0, 2.0), (7.0, 2.0)), walk((7.0, 2.0), (1.0, 2.0)))
    found = tracks(people, 6.0)
    assert found[:, 0, 0].max() > 6.5 and found[:, 1, 0].min() < 1.5
    assert np.linalg.norm(found[:, 0] - found[:, 1], axis=1).min() > 0.5 - 0.15
    meet = np.argmin(np.abs(found[:, 0, 0] - found[:, 1, 0]))
    assert found[meet, 0, 1] < 2.0 < found[meet, 1, 1]


def test_someone_stops_half_a_metre_before_the_robot_and_turns_to_the_next_goal_after_five_seconds() -> None:
    people, robot = walkers(walk((1.0, 2.0), (7.0, 2.0), speed=1.0)), at(4.0, 2.0)
    found = tracks(people, 17.0, robot)[:, 0]
    gap = np.linalg.norm(found + CORNER - robot.position, axis=1) - 0.2 - 0.25
    stands = np.flatnonzero(np.linalg.norm(np.diff(found, axis=0), axis=1) == 0.0)
    waits = stands[stands > 50]
    assert gap[waits[0]] == pytest.approx(0.6, abs=0.12)
    assert 0.02 * (np.argmax(np.diff(waits) > 1) + 1) == pytest.approx(5.0, abs=0.15)
    assert found[450:550, 0].min() < 1.2 and people.touches == [0, 0]


def test_a_robot_that_drives_into_someone_who_stands_is_to_blame_and_again_after_a_gap() -> None:
    people = walkers(walk((4.0, 2.0)))
    way = [*np.arange(2.0, 3.7, 0.01), *np.arange(3.7, 3.52, -0.01), *np.arange(3.52, 3.7, 0.01)]
    for x, after in itertools.pairwise(way):  # back by less than the gap, and again
        people.step(at(x, 2.0), at(after, 2.0), 0.02)
    assert people.touches == [1, 0]
    for x, after in itertools.pairwise([*np.arange(3.7, 3.4, -0.01), *np.arange(3.4, 3.7, 0.01)]):
        people.step(at(x, 2.0), at(after, 2.0), 0.02)
    assert people.touches == [2, 0]


def test_a_blind_walker_who_is_faster_than_the_robot_that_it_meets_is_to_blame() -> None:
    for walker_mps, robot_mps, touches in ((1.3, 0.4, [0, 1]), (1.3, 0.0, [0, 1]), (0.4, 1.3, [1, 0])):
        people = walkers(walk((1.0, 2.0), (7.0, 2.0), speed=walker_mps), walkers_blind=True)
        step = 0.02 * robot_mps
        for k in range(200):
            people.step(at(6.0 - k * step, 2.0), at(6.0 - (k + 1) * step, 2.0), 0.02)
            if any(people.touches):
                break
        assert people.touches == touches
        assert math.dist(people.at[0], at(6.0 - (k + 1) * step, 2.0).position) > 0.2 + 0.25 - 0.03


def test_a_scan_sees_the_legs_as_discs_and_the_draws_of_the_noise_stay_the_same() -> None:
    start = at(1.0, 2.0, 0.4)
    scene = Scene("hall", HALL, start, 0.2, None, (), REGION, walkers=(walk((3.0, 2.0)),))
    config = preset(world={"laser": {"range_m": 1e-4}}, laser={"mount": (0.1, -0.2, 0.5), "beams": 1440})
    people = Walkers(scene, config, start, 0.2)
    seen, clear = (
        World(HALL, start, 0.2, config, np.random.default_rng(1), walkers=p).step(Command()) for p in (people, None)
    )
    nearer = seen.scan.ranges != clear.scan.ranges
    points, legs = start @ seen.scan.points_robot[nearer], people.legs()[:, :2]
    to_legs = np.linalg.norm(points[:, None] - legs[None], axis=2)
    assert np.allclose(to_legs.min(axis=1), 0.06, atol=1e-3) and (to_legs.min(axis=0) < 0.061).all()
    assert np.array_equal(seen.walkers, people.poses) and clear.walkers is None
