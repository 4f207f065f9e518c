"""What moves is told from what stands, and is no evidence."""

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import beams_of, cast_among
from sixthsense.core.returns import bearings_of
from sixthsense.core.source import Tick
from sixthsense.slam.mapping.moving import MovingReturns, _count_seen_through
from sixthsense.slam.slam import Slam

ROOM = np.array([[[-4, -3], [4, -3]], [[4, -3], [4, 3]], [[4, 3], [-4, 3]], [[-4, 3], [-4, -3]],
                 [[1, 1], [1, 3]]], dtype=float)  # fmt: skip
LASER = preset().laser
STEP_NS = 100_000_000


def leg(x: float, y: float) -> Array:
    return np.array([[x, y, 0.06, 0.0, 0.0]])


def scan(pose: Pose, legs: Array | None, rng: np.random.Generator) -> Scan:
    legs = np.zeros((0, 5)) if legs is None else legs
    ranges = cast_among(pose, beams_of(beam_bearings(LASER)), ROOM.reshape(-1, 4), LASER.max_range, legs)
    return Scan.from_config(ranges + rng.normal(0.0, 0.01, len(ranges)), LASER)


def watched(places: list[Array | None], turn: float = 0.0) -> list[tuple[Scan, Scan, Array, Array]]:
    """Of a leg at places, one each tenth of a second: the scan, that without what moves, what moves, and stands."""
    moving, rng, found = MovingReturns(True), np.random.default_rng(0), []
    for k, legs in enumerate(places):
        pose = Pose(-1.0, 0.0, k * turn)
        seen = scan(pose, legs, rng)
        still, parts = moving.split(seen, pose, k * STEP_NS)
        moving.keep(seen, pose, pose, k * STEP_NS)
        found.append((seen, still, pose @ parts.points_robot, pose @ parts.standing_robot))
    return found


def test_nothing_moves_in_a_room_in_which_the_robot_turns() -> None:
    assert all(len(moving) == 0 for _, _, moving, _ in watched([None] * 60, turn=0.1))


def test_who_walks_by_is_taken_out_and_the_wall_stays() -> None:
    seen, still, moving, standing = watched([leg(0.5, -2.0 + 0.1 * k) for k in range(30)])[-1]
    assert len(moving) >= 2 and len(standing) == 0
    assert np.abs(moving - [0.5, 0.9]).max() < 0.15
    taken = np.isnan(still.ranges)
    assert np.count_nonzero(taken) == len(moving)
    assert np.array_equal(still.ranges[~taken], seen.ranges[~taken])


def test_who_has_come_and_stands_is_told_from_who_walks() -> None:
    come = [leg(0.5, -2.0 + 0.1 * k) for k in range(20)]
    _, _, moving, standing = watched([*come, *[leg(0.5, 0.0)] * 40])[-1]
    assert len(standing) == len(moving) >= 2


def test_what_was_never_seen_through_is_furniture() -> None:
    assert all(len(moving) == 0 for _, _, moving, _ in watched([leg(0.5, 0.0)] * 40))


def test_a_pose_that_jumps_makes_nothing_move() -> None:
    moving, rng = MovingReturns(True), np.random.default_rng(0)
    for k in range(20):
        shown = Pose(-1.0, 0.0) if k < 15 else Pose(-1.0, 0.8)
        seen = scan(Pose(-1.0, 0.0), None, rng)
        moving.split(seen, Pose(-1.0, 0.0), k * STEP_NS)
        moving.keep(seen, Pose(-1.0, 0.0), shown, k * STEP_NS)
    _, parts = moving.split(scan(Pose(-1.0, 0.0), None, rng), Pose(-1.0, 0.8), 20 * STEP_NS)
    assert len(parts.points_robot) == 0


def test_the_kernel_finds_what_a_plain_computation_finds() -> None:
    rng = np.random.default_rng(1)
    ranges, pose = rng.uniform(0.5, 4.0, 120), np.array([0.3, -0.2, 0.7])
    ranges[rng.integers(120, size=10)] = np.nan
    points, counts, expected = rng.uniform(-3.0, 3.0, (400, 2)), np.zeros(400, np.int64), []
    _count_seen_through(points, pose, bearings_of(-np.pi, np.pi / 60, 120, True), ranges, counts)
    step = 2.0 * np.pi / 120
    for x, y in points - pose[:2]:
        away = np.hypot(x, y)
        middle = round((np.arctan2(y, x) - pose[2] + np.pi) / step)
        reach = 1 + int((0.05 / away + 0.02) / step)
        near = ranges[np.arange(middle - reach, middle + reach + 1) % 120]
        expected.append(bool((near > away + 0.15).all()) and away > 0.1)
    assert np.array_equal(counts > 0, expected) and 20 < counts.sum() < 380


def test_the_map_forgets_who_walked_by_and_blocks_the_way_through_who_stands() -> None:
    config, rng = preset(people=True), np.random.default_rng(0)
    with Slam(config, Pose(-1.0, 0.0)) as slam:
        for k in range(100):
            y = min(-2.0 + 0.1 * k, 0.0)
            tick = Tick(k * STEP_NS, Pose(-1.0, 0.0, 0.2 * k), scan(Pose(-1.0, 0.0, 0.2 * k), leg(0.5, y), rng))
            step = slam.take(tick)
        grid = step.grid
        assert len(step.moving.standing_robot) >= 2
        space = grid.free_space()
        assert space.is_blocked(np.array([0.5, 0.0])) and not space.is_blocked(np.array([0.5, -1.5]))
        cells = np.argwhere(grid.obstacles)
        places = np.array(grid.origin) + config.grid.cell_m * (cells[:, ::-1] + 0.5)
        assert (np.abs(places - [0.5, 0.0]).max(axis=1) > 0.3).all()
        slam.finish()
        assert not grid.free_space().is_blocked(np.array([0.5, 0.0]))
