import math

import numpy as np
import pytest
from scipy.optimize import brentq

from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.laser import Scan
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command, Tick
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import recorded_drive
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard, _contact_and_gap, stopping_distance
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.world import World

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
    return Scan.from_config(ranges, CONFIG.laser.replaced(beams=beams))


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
    rng, places = np.random.default_rng(seed), np.random.default_rng(100 + seed)
    for _ in range(20):
        points = rng.uniform(-0.9, 0.9, (5, 2))
        points = points[np.linalg.norm(points, axis=1) > RADIUS + 0.01]
        command = Command(float(rng.choice([-0.5, 0.3])), float(rng.choice([0.0, rng.uniform(-2.0, 2.0)])))
        pose = Pose(*places.uniform(-3, 3, 3))
        contact, gap = _contact_and_gap(
            pose @ points, pose.x, pose.y, pose.theta, command.speed, command.turn_rate, RADIUS, 0.6
        )
        expected = marched(points, command, RADIUS, 0.6)
        assert contact == pytest.approx(expected, abs=3e-3) or (min(contact, expected) > 0.59)
        ahead = points[np.sign(command.speed) * points[:, 0] > 0.0]
        nearest = min((float(np.hypot(*p)) - RADIUS for p in ahead), default=math.inf)
        assert gap == pytest.approx(nearest, abs=1e-9) or nearest > 0.6


@pytest.mark.parametrize("seed", range(40))
def test_a_robot_that_obeys_the_guard_tick_by_tick_never_touches_what_it_has_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    away, bearing = rng.uniform((RADIUS + 0.02, -math.pi), (1.5, math.pi), (int(rng.integers(1, 13)), 2)).T
    guard, seen = guard_before(np.column_stack([away * np.cos(bearing), away * np.sin(bearing)]))
    pose = Pose()
    for k in range(100):
        if k % (1 + seed % 9) == 0:  # some keep a wish for longer
            wish = Command(float(rng.choice([-0.5, 0.2, 0.5])), float(rng.choice([-1.0, 0.0, 0.4])))
        command = guard.check(wish)
        step = rk4(Pose(), command.speed, command.turn_rate, 0.02)
        pose = pose @ step
        guard.moved(step)
        assert np.linalg.norm(seen - pose.position, axis=1).min() > RADIUS


def test_a_robot_may_always_turn_on_the_spot_and_is_counted_once_for_each_stop() -> None:
    guard, _ = guard_before(np.array([[0.201, 0.0], [0.0, 0.201], [-0.201, 0.0], [0.0, -0.201]]))
    assert guard.check(Command(0.0, 0.7)) == Command(0.0, 0.7) and (guard.stopped, guard.stops) == (False, 0)
    for speed, stops in ((0.3, 1), (0.4, 1), (0.0, 1), (0.3, 2)):
        assert guard.check(Command(speed, 0.6)) == Command(0.0, 0.6)
        assert (guard.stopped, guard.stops) == (speed > 0.0, stops)


OWN = merge(CONFIG, {"robot": {"deceleration": 1.3, "control_period_s": 0.03},
                     "laser": {"period_ticks": 3, "mount": (0.12, -0.07, 0.3)}})  # fmt: skip
LATENCY_S, KEPT_M = 4 * 0.03, RADIUS + 0.02
ARC = Command(0.55, 0.33)


def distance_to_stop(speed: float) -> float:
    """Plain reference: constant speed while nothing happens, then constant braking."""
    return speed * LATENCY_S + speed**2 / (2 * 1.3)


def fastest(distance: float) -> float:
    return float(brentq(lambda speed: distance_to_stop(speed) - distance, 0.0, 9.0, xtol=1e-14))


def seen_at(distance: float, bearing: float, moves: bool = False, before: Pose | None = None) -> Guard:
    """A guard that has seen one return, in the robot's frame, by a laser that is mounted aside and turned."""
    guard, mount = Guard(OWN, RADIUS), Pose(*OWN.laser.mount)
    guard.moved(before or Pose())
    point = distance * np.array([math.cos(bearing), math.sin(bearing)])
    x, y = mount.inverse() @ point
    row = np.array([math.hypot(x, y), np.inf], dtype=np.float32)
    guard.see(Scan(row, math.atan2(y, x), 0.7, 9.0, mount), point[None] if moves else np.zeros((0, 2)))
    return guard


def contact_at(arc_m: float, aside_m: float = 0.1) -> tuple[float, float]:
    """Range and bearing of a return that the disc touches, beside its middle, when it has driven so far on `ARC`."""
    centre = rk4(Pose(), ARC.speed, ARC.turn_rate, arc_m / ARC.speed)
    x, y = centre @ np.array([math.sqrt(KEPT_M**2 - aside_m**2), aside_m])
    return math.hypot(x, y), math.atan2(y, x)


def test_a_return_ahead_beside_the_way_slows_to_the_speed_that_stops_before_it() -> None:
    assert stopping_distance(0.55, LATENCY_S, 1.3) == pytest.approx(distance_to_stop(0.55))
    for ratio in (0.6, 0.999, 1.001):
        gap = ratio * distance_to_stop(ARC.speed)
        found = seen_at(KEPT_M + gap, -1.4).check(ARC)
        assert found.speed == pytest.approx(fastest(gap) if ratio < 1.0 else ARC.speed, rel=1e-5)
        assert found.turn_rate / found.speed == pytest.approx(ARC.turn_rate / ARC.speed)


def test_a_return_ahead_slows_to_creep_speed_and_one_behind_does_not_slow() -> None:
    for bearing, speed in ((1.5, 0.1), (-1.5, 0.1), (1.64, 0.55), (-1.64, 0.55)):
        guard, away = seen_at(KEPT_M + 0.003, bearing), -math.copysign(0.02, bearing)
        assert guard.check(Command(0.55, away)).speed == pytest.approx(speed) and not guard.stopped
        assert guard.check(Command(-0.55, -away)).speed == pytest.approx(speed - 0.65) and not guard.stopped


def test_a_return_on_the_way_stops_where_creep_speed_would_touch_it() -> None:
    for ratio, is_stopped in ((0.97, True), (1.03, False)):
        guard = seen_at(*contact_at(ratio * distance_to_stop(0.1)))
        found = guard.check(ARC)
        assert (guard.stopped, found.turn_rate == ARC.turn_rate) == (is_stopped, is_stopped)
        assert found.speed == (0.0 if is_stopped else pytest.approx(0.1, rel=0.05))
        assert guard.check(Command(-ARC.speed, ARC.turn_rate)).speed == -ARC.speed


def test_what_moves_is_kept_a_body_away_and_is_waited_for_only_if_it_is_nearest() -> None:
    for moves, ratio in ((True, 1.001), (True, 0.95), (False, 0.95)):
        gap = ratio * distance_to_stop(ARC.speed)
        found = seen_at(KEPT_M + 0.2 + gap, 0.1, moves).check(ARC).speed
        assert found == pytest.approx(fastest(gap) if moves and ratio < 1.0 else ARC.speed, rel=1e-5)
    for moves, is_stopped in ((True, True), (False, False)):
        guard = seen_at(KEPT_M + 0.16, 0.1, moves)
        assert guard.check(ARC).speed == 0.0 or not is_stopped
        assert guard.stopped == guard.waits_for_moving == is_stopped
    guard.see(scan_of(np.array([[KEPT_M + 0.001, 0.02]])), np.array([[KEPT_M + 0.3, 0.02]]))
    assert guard.check(ARC).speed == 0.0 and not guard.waits_for_moving
    guard = seen_at(KEPT_M + 0.01, 0.1, moves=True)
    assert guard.check(ARC).speed == 0.0
    guard.see(Scan.from_config(np.full(360, np.inf), OWN.laser))  # it is forgotten with the next scan
    assert guard.check(ARC) == ARC


def test_the_motion_since_the_scan_counts_until_the_next_one() -> None:
    far, motion = KEPT_M + 1.3 * distance_to_stop(ARC.speed), Pose(0.07, 0.01, 0.05)
    guard, point = seen_at(far, 0.2), far * np.array([math.cos(0.2), math.sin(0.2)])
    assert guard.check(ARC) == ARC
    guard.moved(motion)
    guard.moved(motion)
    gap = float(np.linalg.norm((motion @ motion).inverse() @ point)) - KEPT_M
    assert guard.check(ARC).speed == pytest.approx(fastest(gap), rel=1e-5)
    # The next scan does not see the return: it is kept from without the buffer, for a second.
    at = (motion @ motion).inverse() @ point
    for k in range(12):
        guard.see(Scan.from_config(np.full(360, np.inf), OWN.laser))
        is_remembered = k < math.ceil(1.0 / (OWN.laser.period_ticks * OWN.robot.control_period_s))
        contact = marched(at[None], ARC, RADIUS, 9.0) if is_remembered else math.inf
        limit = fastest(contact) if math.isfinite(contact) else math.inf
        assert guard.check(ARC).speed == pytest.approx(min(limit, ARC.speed), rel=6e-3)  # steps of 1 mm


def test_earlier_returns_are_kept_by_their_distance_from_the_robot_wherever_its_laser_is() -> None:
    config = merge(CONFIG, {"laser": {"mount": (-0.9, 0.1, 0.3)}})
    guard, scan = Guard(config, RADIUS), Scan.from_config(np.full(config.laser.beams, 1.2), config.laser)
    near = scan.points_robot[np.linalg.norm(scan.points_robot, axis=1) < 0.5]
    guard.see(scan)
    guard.see(scan)
    kept = guard.obstacles().earlier
    assert len(near) > 10 and all((np.abs(kept - point).max(axis=1) < 1e-9).any() for point in near)


def test_an_earlier_return_is_where_odometry_has_left_it() -> None:
    far, bearing = 0.44, 0.45
    guard, point = seen_at(far, bearing, before=Pose(0.3, -0.2, 1.1)), far * rotation(bearing)[:, 0]
    onward, turn = Pose(0.05, -0.03, 0.25), Pose(0.06, 0.02, 0.2)
    guard.moved(onward)
    guard.see(Scan.from_config(np.full(360, np.inf), OWN.laser))
    guard.moved(turn)
    contact = marched(((onward @ turn).inverse() @ point)[None], ARC, RADIUS, 9.0)
    assert 0.05 < contact < distance_to_stop(ARC.speed)
    assert guard.check(ARC).speed == pytest.approx(fastest(contact), rel=6e-3)


def test_without_the_guard_or_a_scan_and_with_beams_that_return_nothing_a_command_is_unchanged() -> None:
    near = np.array([[0.21, 0.01]])
    assert guard_before(near)[0].check(ARC) != ARC
    assert guard_before(near, merge(CONFIG, {"safety": {"guard": False}}))[0].check(ARC) == ARC
    guard, mount = Guard(OWN, RADIUS), Pose(*OWN.laser.mount)
    assert guard.check(ARC) == ARC
    guard.see(Scan(np.array([0.0, 0.375, np.inf], dtype=np.float32), 0.6, 0.3, 0.375, mount))  # at most 0.375 m
    assert guard.check(ARC) == ARC
    guard.see(Scan(np.array([0.0, 0.374, np.inf], dtype=np.float32), 0.6, 0.3, 0.375, mount))
    assert guard.check(ARC) != ARC


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
    rng = np.random.default_rng(0)
    config = merge(config, {"task": "goal"})
    navigator = make_navigator(config, Pose(), np.array([goal]), (0.0, 0.0, 1.0, 1.0), 0.2, rng, rng)
    scene = Scene("hall", HALL, Pose(), RADIUS, goal, (), (-1.0, -2.0, 6.0, 2.0))
    trace = Trace(config, scene, RADIUS)
    recorded_drive(source, Pose(), Pilot(navigator, Guard(config, RADIUS)), trace)
    return trace


@pytest.mark.parametrize("seed", range(2))
def test_the_robot_does_not_touch_a_wall_that_appears_before_it_and_drives_around(seed: int) -> None:
    config = preset("default").replaced(seed=seed, max_time=120.0)
    trace = driven(config, SuddenWall)
    assert trace.outcome == "goal reached"
    assert driven(merge(config, {"safety": {"guard": False}}), SuddenWall).outcome == "collided"


SLIPPING = {"slip_position_per_sqrt_m": 0.025, "slip_position_per_sqrt_rad": 0.01,
            "slip_heading_per_sqrt_m": 0.0436, "slip_heading_per_sqrt_rad": 0.0436}  # fmt: skip
NOISY = [
    ("worn", {"world": {"motion": SLIPPING}}),
    ("default", {"world": {"motion": {"speed": 0.4, "turn_rate": 0.4}, "laser": {"range_m": 0.03}}}),
]


@pytest.mark.parametrize(("name", "changes"), NOISY)
def test_a_robot_much_noisier_than_assumed_touches_nothing(name: str, changes: dict[str, object]) -> None:
    config = merge(preset(name).replaced(seed=1, max_time=60.0), changes)
    assert measure(driven(config, SuddenWall))["collisions"] == 0


@pytest.mark.parametrize(("distance_m", "moves", "told_s"), [(0.02, False, 1.7), (0.1, True, 3.7)])
def test_a_stopped_robot_waits_a_second_and_three_for_someone_before_it_seeks_another_way(
    distance_m: float, moves: bool, told_s: float
) -> None:
    told: list[float] = []

    class Ahead(Navigator):
        now_s = 0.0

        def step(self, pose: Pose, stamp_ns: int) -> Command:
            self.now_s = 1e-9 * stamp_ns
            return Command(0.5, 0.1)

        def guard_stopped(self, pose: Pose) -> None:
            told.append(self.now_s)

    pilot, ahead = Pilot(Ahead(), Guard(CONFIG, RADIUS)), np.array([[RADIUS + distance_m, 0.0]])
    for begin_s in (0.7, 10.7):  # someone who has gone, and comes again, is waited for again
        told.clear()
        pilot.guard.see(scan_of(ahead), ahead if moves else ahead[:0])
        for k in range(40):
            assert pilot.command(Pose(), round((begin_s + 0.1 * k) * 1e9)).speed == 0.0
        assert told[0] == pytest.approx(told_s + begin_s - 0.7)
        for _ in range(12):  # a second
            pilot.guard.see(Scan.from_config(np.full(360, np.inf), CONFIG.laser))
        assert pilot.command(Pose(), round((begin_s + 4.0) * 1e9)) == Command(0.5, 0.1)
