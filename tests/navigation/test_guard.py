import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command, Tick
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import recorded_drive
from sixthsense.navigation.goal_navigator import goal_navigator
from sixthsense.navigation.guard import Guard, _limits, latency_s, stopping_distance
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.navigation.planners import make_planner
from sixthsense.record.trace import Trace
from sixthsense.sources.scene import Scene
from sixthsense.sources.world import World

CONFIG = Config()
RADIUS = 0.2
HALL = np.array([[[-1, -2], [6, -2]], [[6, -2], [6, 2]], [[6, 2], [-1, 2]], [[-1, 2], [-1, -2]]], dtype=np.float64)


def scan_of(points: Array) -> Scan:
    """A scan with exactly these (N, 2) returns, in the robot's frame."""
    bearings = np.arctan2(points[:, 1], points[:, 0])
    beams = 3600
    ranges = np.full(beams, np.inf)
    index = np.round((bearings + math.pi) / (2.0 * math.pi / beams)).astype(int) % beams
    for i, r in zip(index, np.hypot(points[:, 0], points[:, 1]), strict=True):
        ranges[i] = min(ranges[i], r)
    return Scan.from_config(ranges, dataclasses.replace(CONFIG.laser, beams=beams))


def guard_before(points: Array, config: Config = CONFIG) -> tuple[Guard, Array]:
    """A guard that has seen these returns, and the returns as rounded to float32 and to the beams' bearings."""
    guard, scan = Guard(config, RADIUS), scan_of(points)
    guard.see(scan)
    return guard, scan.points_robot[np.isfinite(scan.ranges)]


def marched(points: Array, command: Command, radius: float, reach: float) -> float:
    """Plain reference: the distance along a command's arc, in small steps, at which the disc first touches a point."""
    step = 1e-3
    for k in range(math.ceil(reach / step) + 1):
        before = rk4(Pose(), command.speed, command.turn_rate, k * step / abs(command.speed))
        after = rk4(Pose(), command.speed, command.turn_rate, (k + 1) * step / abs(command.speed))
        near, nearer = (np.linalg.norm(points - pose.position, axis=1) for pose in (before, after))
        if np.any((near <= radius) & (nearer < near)):
            return k * step
    return math.inf


@pytest.mark.parametrize("seed", range(4))
def test_the_distance_to_the_first_contact_is_that_of_a_disc_moved_along_the_arc(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(40):
        points = rng.uniform(-0.9, 0.9, (5, 2))
        points = points[np.linalg.norm(points, axis=1) > RADIUS + 0.01]
        command = Command(float(rng.choice([-0.5, 0.3])), float(rng.choice([0.0, rng.uniform(-2.0, 2.0)])))
        contact, gap = _limits(points, 0.0, 0.0, 0.0, command.speed, command.turn_rate, RADIUS, 0.6)
        expected = marched(points, command, RADIUS, 0.6)
        assert contact == pytest.approx(expected, abs=3e-3) or (min(contact, expected) > 0.59)
        ahead = points[np.sign(command.speed) * points[:, 0] > 0.0]
        nearest = min((float(np.hypot(*p)) - RADIUS for p in ahead), default=math.inf)
        assert gap == pytest.approx(nearest, abs=1e-12) or nearest > 0.6


def test_the_distances_do_not_depend_on_the_robots_pose() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        points, pose = rng.uniform(-1, 1, (8, 2)), Pose(*rng.uniform(-3, 3, 3))
        here = _limits(points, 0.0, 0.0, 0.0, 0.4, 0.7, 0.1, 0.8)
        there = _limits(pose @ points, pose.x, pose.y, pose.theta, 0.4, 0.7, 0.1, 0.8)
        assert there == pytest.approx(here, abs=1e-9)


@settings(max_examples=200, deadline=None)
@given(
    distance=st.floats(0.0, 1.5),
    left=st.floats(-0.6, 0.6),
    speed=st.floats(0.02, 0.5),
    deceleration=st.floats(0.2, 5.0),
    period_ticks=st.integers(1, 20),
)
def test_in_straight_motion_the_disc_stops_before_any_return(
    distance: float, left: float, speed: float, deceleration: float, period_ticks: int
) -> None:
    """The robot continues for the latency under the allowed command, and then brakes."""
    robot, laser = {"deceleration": deceleration}, {"period_ticks": period_ticks}
    config = merge(CONFIG, {"robot": robot, "laser": laser})
    point = np.array([[RADIUS + config.safety.buffer_m + distance, left]])
    guard, seen = guard_before(point, config)
    allowed = guard.check(Command(speed, 0.0))
    distance_m = stopping_distance(allowed.speed, latency_s(config), deceleration)
    for travelled in np.linspace(0.0, distance_m, 50):
        assert np.linalg.norm(seen - (travelled, 0.0), axis=1).min() > RADIUS


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_a_robot_that_obeys_the_guard_tick_by_tick_never_touches_what_it_has_seen(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 12))
    polar = [(data.draw(st.floats(RADIUS + 0.02, 1.5)), data.draw(st.floats(-math.pi, math.pi))) for _ in range(count)]
    guard, seen = guard_before(np.array([(r * math.cos(b), r * math.sin(b)) for r, b in polar]))
    pose = Pose()
    for _ in range(100):
        wish = Command(data.draw(st.sampled_from([-0.5, 0.2, 0.5])), data.draw(st.sampled_from([-1.0, 0.0, 0.4])))
        command = guard.check(wish)
        step = rk4(Pose(), command.speed, command.turn_rate, 0.02)
        pose = pose @ step
        guard.moved(step)
        assert np.linalg.norm(seen - pose.position, axis=1).min() > RADIUS


def test_a_robot_may_always_turn_on_the_spot() -> None:
    guard, _ = guard_before(np.array([[0.201, 0.0], [0.0, 0.201], [-0.201, 0.0], [0.0, -0.201]]))
    assert guard.check(Command(0.0, 1.0)) == Command(0.0, 1.0)
    assert not guard.stopped
    assert guard.check(Command(0.3, 0.5)) == Command(0.0, 0.5)
    assert guard.stopped and guard.stops == 1


def test_a_robot_may_move_away_from_a_return_that_it_almost_touches() -> None:
    guard, _ = guard_before(np.array([[0.19, 0.0]]))
    assert guard.check(Command(0.5, 0.0)).speed == 0.0
    assert guard.check(Command(-0.5, 0.0)).speed == -0.5


def corridor(width: float) -> Array:
    x = np.linspace(-1.0, 1.0, 400)
    return np.concatenate([np.column_stack([x, np.full(400, y)]) for y in (-0.5 * width, 0.5 * width)])


def test_the_speed_decreases_with_the_width_of_a_corridor_down_to_creep_speed() -> None:
    speeds = [guard_before(corridor(width))[0].check(Command(0.5, 0.0)).speed for width in (0.45, 0.5, 0.6, 0.7, 0.9)]
    assert speeds == sorted(speeds)
    assert speeds[0] == pytest.approx(CONFIG.safety.creep)
    assert speeds[0] < speeds[2] < speeds[-1] == 0.5


def test_a_slowed_command_stays_on_its_arc() -> None:
    guard, _ = guard_before(corridor(0.55))
    slow = guard.check(Command(0.4, 0.1))
    assert 0.0 < slow.speed < 0.4
    assert slow.turn_rate / slow.speed == pytest.approx(0.1 / 0.4)


def test_a_better_brake_and_a_faster_scanner_allow_more_speed() -> None:
    def speed(deceleration: float, ticks: int) -> float:
        config = merge(CONFIG, {"robot": {"deceleration": deceleration}, "laser": {"period_ticks": ticks}})
        return guard_before(np.array([[0.27, 0.0]]), config)[0].check(Command(0.5, 0.0)).speed

    assert speed(0.5, 5) < speed(2.0, 5) < speed(2.0, 1)


def test_without_the_guard_every_command_is_unchanged() -> None:
    guard, _ = guard_before(np.array([[0.21, 0.0]]), merge(CONFIG, {"safety": {"guard": False}}))
    assert guard.check(Command(0.5, 0.1)) == Command(0.5, 0.1)


def test_before_the_first_scan_and_without_returns_every_command_is_unchanged() -> None:
    guard = Guard(CONFIG, RADIUS)
    assert guard.check(Command(0.5, 0.1)) == Command(0.5, 0.1)
    guard.see(Scan.from_config(np.full(360, np.inf), CONFIG.laser))
    assert guard.check(Command(0.5, 0.1)) == Command(0.5, 0.1)


class SuddenWall(World):
    """A world in which a wall appears across the robot's path, `ahead_m` before its disc, at a tick."""

    ahead_m = 0.1
    at_tick = 60

    def step(self, command: Command) -> Tick | None:
        if self._ticks == self.at_tick:
            wall = self._truth @ np.array([[RADIUS + self.ahead_m, -0.6], [RADIUS + self.ahead_m, 0.6]])
            self._place(np.concatenate([HALL, wall[None]]))
        return super().step(command)


def driven(config: Config, kind: type[World], goal: tuple[float, float] = (5.0, 0.0)) -> Trace:
    source = kind(HALL, Pose(), RADIUS, config, np.random.default_rng(config.seed))
    navigator = goal_navigator(np.array([goal]), make_planner("astar"), config)
    scene = Scene("hall", HALL, Pose(), RADIUS, goal, (), (-1.0, -2.0, 6.0, 2.0))
    trace = Trace(config, scene, RADIUS)
    recorded_drive(source, Pose(), Pilot(navigator, Guard(config, RADIUS)), trace)
    return trace


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_does_not_touch_a_wall_that_appears_before_it_and_drives_around(seed: int) -> None:
    config = dataclasses.replace(preset("default"), seed=seed, max_time=120.0)
    trace = driven(config, SuddenWall)
    assert trace.outcome == "goal reached"
    assert driven(merge(config, {"safety": {"guard": False}}), SuddenWall).outcome == "collided"


SLIPPING = {"slip_position_per_sqrt_m": 0.025, "slip_position_per_sqrt_rad": 0.01,
            "slip_heading_per_sqrt_m": 0.0436, "slip_heading_per_sqrt_rad": 0.0436}  # fmt: skip
NOISY = [
    ("worn", {"world": {"motion": SLIPPING}}),
    ("default", {"world": {"motion": {"speed": 0.4, "turn_rate": 0.4}, "laser": {"range_m": 0.03}}}),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "changes"), NOISY)
def test_a_robot_much_noisier_than_assumed_touches_nothing(name: str, changes: dict[str, object], seed: int) -> None:
    config = merge(dataclasses.replace(preset(name), seed=seed, max_time=60.0), changes)
    assert measure(driven(config, SuddenWall))["collisions"] == 0


def moving_ahead(distance_m: float) -> Array:
    return np.array([[distance_m, 0.0], [distance_m, 0.05]])


def test_the_guard_keeps_a_body_from_what_moves_and_less_from_a_wall() -> None:
    ahead = moving_ahead(RADIUS + 0.15)
    guard, _ = guard_before(ahead)
    assert guard.check(Command(0.1, 0.0)).speed > 0.0 and not guard.waits_for_moving
    guard.see(scan_of(ahead), ahead)
    assert guard.check(Command(0.1, 0.0)) == Command(0.0, 0.0) and guard.waits_for_moving
    assert guard.check(Command(-0.1, 0.0)) == Command(-0.1, 0.0)


def test_a_robot_that_someone_stops_waits_for_three_seconds_before_it_seeks_another_way() -> None:
    told: list[float] = []

    class Ahead(Navigator):
        def step(self, pose: Pose, stamp_ns: int) -> Command:
            self.now_s = 1e-9 * stamp_ns
            return Command(0.5, 0.0)

        def guard_stopped(self, pose: Pose) -> None:
            told.append(self.now_s)

    for distance_m, moves, expected_s in ((0.02, False, 0.0), (0.1, True, 3.0)):
        told.clear()
        pilot, ahead = Pilot(Ahead(), Guard(CONFIG, RADIUS)), moving_ahead(RADIUS + distance_m)
        pilot.guard.see(scan_of(ahead), ahead if moves else np.zeros((0, 2)))
        for k in range(50):
            assert pilot.command(Pose(), k * 100_000_000) == Command()
        assert told[0] == pytest.approx(expected_s)
