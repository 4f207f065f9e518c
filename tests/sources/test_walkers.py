"""People in the simulated building: where they go, what the laser sees of them, and whom they touch."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.source import Command
from sixthsense.loop.run import run
from sixthsense.sources.scene import Scene, load_scene
from sixthsense.sources.walkers import LEG_M, Walkers, walkers_of
from sixthsense.sources.walking_space import BODY_M, ScriptedWalk, WalkingSpace
from sixthsense.sources.world import World

HALL = np.array([[[0, 0], [8, 0]], [[8, 0], [8, 4]], [[8, 4], [0, 4]], [[0, 4], [0, 0]]], dtype=float)
DIVIDED = np.concatenate([HALL, [[[4.0, 0.0], [4.0, 1.5]], [[4.0, 2.5], [4.0, 4.0]]]])
REGION = (0.0, 0.0, 8.0, 4.0)
AWAY = Pose(100.0, 100.0, 0.0)


def walkers(*walks: ScriptedWalk, walls: Array = HALL, start: Pose = AWAY, **world: object) -> Walkers:
    scene = Scene("hall", walls, start, 0.2, None, (), REGION, walkers=walks)
    found = walkers_of(scene, preset(world=world), start, 0.2)
    assert found is not None
    return found


def walk(*points: tuple[float, float], speed: float = 1.0) -> ScriptedWalk:
    return ScriptedWalk(points, speed)


def tracks(people: Walkers, seconds: float, robot: Pose = AWAY) -> Array:
    """(S, N, 2) where they are, every tick of 0.02 s, beside a robot that stands."""
    found = []
    for _ in range(round(seconds / 0.02)):
        people.step(robot, robot, 0.02)
        found.append(people.at)
    return np.array(found)


def test_distances_to_walls_are_those_of_a_plain_computation() -> None:
    space = WalkingSpace(DIVIDED, REGION)
    rows, cols = np.indices(space.free.shape)
    centres = space.centres(np.stack([rows, cols], axis=-1).reshape(-1, 2))
    plain = np.array([point_segment_distance(p, DIVIDED).min() >= BODY_M for p in centres])
    assert np.array_equal(space.free.ravel(), plain)


def test_a_way_is_as_short_as_dijkstras() -> None:
    space = WalkingSpace(DIVIDED, REGION)
    free, number = space.free, np.arange(space.free.size).reshape(space.free.shape)
    ends, costs = [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        for r, c in np.argwhere(free):
            if not (0 <= r + down < free.shape[0] and 0 <= c + across < free.shape[1] and free[r + down, c + across]):
                continue
            if down and across and not (free[r, c + across] and free[r + down, c]):
                continue
            ends.append((number[r, c], number[r + down, c + across]))
            costs.append(np.hypot(down, across))
    graph = coo_array((costs, np.array(ends).T), shape=(free.size, free.size)).tocsr()
    rng = np.random.default_rng(0)
    cells = np.argwhere(free)[rng.integers(np.count_nonzero(free), size=(8, 2))]
    for first, last in cells:
        from sixthsense.sources.walking_space import _STEPS, _search

        before = np.full(free.shape, -1, dtype=np.int8)
        assert _search(free, tuple(first), tuple(last), before)
        cost, cell = 0.0, tuple(last)
        while cell != tuple(first):
            step = _STEPS[before[cell]]
            cost, cell = cost + np.hypot(*step), (cell[0] - step[0], cell[1] - step[1])
        shortest = dijkstra(graph, directed=False, indices=number[tuple(first)])[number[tuple(last)]]
        assert cost == pytest.approx(shortest, abs=1e-6)


def test_people_walk_through_the_door_from_room_to_room_at_their_speed() -> None:
    people = walkers(walls=DIVIDED, start=Pose(1.0, 1.0, 0.0), walkers=2)
    found = tracks(people, 120.0)
    sides = found[..., 0] > 4.0
    assert (sides.any(axis=0) & ~sides.all(axis=0)).all()
    steps = np.linalg.norm(np.diff(found, axis=0), axis=2) / 0.02
    assert steps.max() <= 1.5 + 1e-9
    assert all(0.5 <= steps[:, k].max() <= 1.5 for k in range(2))
    wall = point_segment_distance
    assert min(wall(p, DIVIDED).min() for p in found[::10].reshape(-1, 2)) > BODY_M - 0.08  # by cells of 0.1 m


def test_the_same_seed_gives_the_same_people_and_no_people_draw_nothing() -> None:
    config = preset(world={"walkers": 3}, seed=4)
    one, other = (walkers_of(load_scene("apartment"), config, Pose(11.6, 0.8, 0.0), 0.18) for _ in range(2))
    assert one is not None and other is not None
    assert np.array_equal(tracks(one, 20.0), tracks(other, 20.0))
    assert walkers_of(load_scene("apartment"), preset(), Pose(11.6, 0.8, 0.0), 0.18) is None


def test_two_people_who_meet_pass_each_other() -> None:
    people = walkers(walk((1.0, 2.0), (7.0, 2.0)), walk((7.0, 2.0), (1.0, 2.0)))
    found = tracks(people, 8.0)
    assert found[:, 0, 0].max() > 6.5 and found[:, 1, 0].min() < 1.5
    assert np.linalg.norm(found[:, 0] - found[:, 1], axis=1).min() > 2.0 * BODY_M - 0.15


def test_someone_stops_half_a_metre_before_the_robot_and_steps_aside_after_five_seconds() -> None:
    people, robot = walkers(walk((1.0, 2.0), (7.0, 2.0))), Pose(4.0, 2.0, 0.0)
    gap = np.linalg.norm(tracks(people, 6.5, robot)[:, 0] - robot.position, axis=1) - 0.2 - BODY_M
    assert gap.min() == pytest.approx(0.5, abs=0.15)
    found = tracks(people, 10.0, robot)
    assert found[:, 0, 0].max() > 6.5 and people.touches == [0, 0]


def test_a_blind_walker_touches_a_robot_that_stands_by_its_own_fault() -> None:
    people, robot = walkers(walk((1.0, 2.0), (7.0, 2.0)), walkers_blind=True), Pose(4.0, 2.0, 0.0)
    found = tracks(people, 4.0, robot)
    assert people.touches == [0, 1]
    assert np.linalg.norm(found[:, 0] - robot.position, axis=1).min() > 0.2 + BODY_M - 0.01


def test_a_robot_that_drives_into_someone_who_stands_is_to_blame() -> None:
    people = walkers(walk((4.0, 2.0)))
    for k in range(200):
        people.step(Pose(2.0 + 0.01 * k, 2.0), Pose(2.0 + 0.01 * (k + 1), 2.0), 0.02)
    assert people.touches == [1, 0]


def test_one_leg_stands_while_the_other_swings() -> None:
    people = walkers(walk((1.0, 2.0), (7.0, 2.0)))
    tracks(people, 1.0)
    before = people.legs()
    tracks(people, 0.02)
    after = people.legs()
    speeds = np.sort(np.linalg.norm(after[:, :2] - before[:, :2], axis=1)) / 0.02
    assert speeds == pytest.approx([0.0, 2.0], abs=1e-6)
    assert np.sort(np.hypot(before[:, 3], before[:, 4])) == pytest.approx([0.0, 2.0], abs=1e-6)
    assert (before[:, 2] == LEG_M).all()


def test_a_scan_sees_the_legs_and_the_draws_of_the_noise_stay_the_same() -> None:
    scene = Scene("hall", HALL, Pose(1.0, 2.0, 0.0), 0.2, None, (), REGION, walkers=(walk((3.0, 2.0)),))
    config = preset()
    people = walkers_of(scene, config, Pose(1.0, 2.0, 0.0), 0.2)
    seen, clear = (
        World(HALL, Pose(1.0, 2.0, 0.0), 0.2, config, np.random.default_rng(1), walkers=p).step(Command())
        for p in (people, None)
    )
    assert seen is not None and clear is not None and seen.scan is not None and clear.scan is not None
    nearer = seen.scan.ranges != clear.scan.ranges
    assert 2 <= np.count_nonzero(nearer) <= 20
    points = Pose(1.0, 2.0, 0.0) @ seen.scan.points_robot[nearer]
    assert np.linalg.norm(points - np.array([3.0, 2.0]), axis=1).max() < 0.35
    assert seen.walkers is not None and clear.walkers is None


def test_a_run_records_the_true_tracks_and_expects_people() -> None:
    trace = run(preset(scene="apartment", world={"walkers": 2}, max_time=1.0))
    assert trace.config.people
    assert len(trace.walkers) == len(trace.stamps_ns) and trace.walkers[0].shape == (2, 3)
    assert trace.touches == (0, 0)
    assert not run(preset(scene="apartment", max_time=0.2)).config.people
