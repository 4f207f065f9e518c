"""A pilot that steers ahead of the estimate commands what one that is never late commands."""

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Command, Tick
from sixthsense.live.robot import AheadPilot
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import TURN_RATE, Pilot
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam

CONFIG = preset(seed=2)
HALL = np.array(
    [[[-1, -2], [6, -2]], [[6, -2], [6, 2]], [[6, 2], [-1, 2]], [[-1, 2], [-1, -2]], [[2, -2], [2, -0.5]]], dtype=float
)


def to_goal() -> Navigator:
    rng = np.random.default_rng(0)
    config = CONFIG.replaced(task="goal")
    return make_navigator(config, Pose(), np.array([[4.0, -1.0]]), (0.0, 0.0, 1.0, 1.0), 0.2, rng, rng)


def test_commands_ahead_of_the_last_scan_are_those_of_a_pilot_that_takes_every_tick():
    """Slam of the one takes odometry at once, that of the other only with the next scan."""
    world = World(HALL, Pose(), 0.2, CONFIG, np.random.default_rng(0))
    punctual = Pilot(to_goal(), Guard(CONFIG, 0.2))
    ahead = AheadPilot(to_goal(), Guard(CONFIG, 0.2))
    command, other, held = Command(), Command(), []
    moved = 0
    with Slam(CONFIG) as slam, Slam(CONFIG) as late_slam:
        for _ in range(600):
            tick = world.step(command)
            assert tick is not None
            command = punctual.steer(slam.take(tick))
            held.append(tick)
            if tick.scan is not None:
                for old in held:
                    in_force = ahead.steer(late_slam.take(old))
                    assert in_force == other
                held = []
                last = tick
            other = ahead.ahead(last.odometry.inverse() @ tick.odometry, tick.stamp_ns)
            assert (other.speed, other.turn_rate) == pytest.approx((command.speed, command.turn_rate), abs=1e-6)
            moved += command != Command()
    assert moved > 300


def test_a_late_scan_leaves_earlier_returns_where_they_are():
    """Scans are older than the newest odometry: the guard goes back to where they were taken."""
    guard = Guard(CONFIG, 0.2)
    pilot = AheadPilot(Forward(), guard)
    start, step = Pose(0.5, 1.4, 0.05), Pose(0.1, 0.0, -0.03)
    world = World(HALL, start, 0.2, CONFIG, np.random.default_rng(0))
    first = world.step(Command())
    assert first is not None and first.scan is not None
    with Slam(CONFIG, start) as slam:
        pilot.steer(slam.take(first))
        at = first.odometry
        for k in range(1, 5):
            at = at @ step
            late = step @ step @ step  # odometry is three steps ahead of the scan
            pilot.ahead(step @ late, k)
            scan = Scan.from_config(
                cast_rays(start @ first.odometry.inverse() @ at, beam_bearings(CONFIG.laser), HALL, 9.0), CONFIG.laser
            )
            pilot.steer(slam.take(Tick(first.stamp_ns + 10**8 * k, at, scan)))
            pilot.ahead(late, k)
        obstacles = guard.obstacles()
    T_world_guard = start @ first.odometry.inverse() @ at @ late @ Pose(*guard._at).inverse()
    far_m = [point_segment_distance(point, HALL).min() for point in T_world_guard @ obstacles.earlier]
    assert len(far_m) > 50 and max(far_m) < 0.06


class Forward(Navigator):
    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.5, 0.0)


def test_the_guard_knows_the_motion_since_the_scan_even_if_no_step_has_brought_it():
    pilot = AheadPilot(Forward(), Guard(CONFIG, 0.2))
    assert pilot.ahead(Pose(1.0, 0.0, 0.0), 0) == Command()  # before the first step
    tick = World(np.array([[[2.0, -1.0], [2.0, 1.0]]]), Pose(), 0.2, CONFIG, np.random.default_rng(0)).step(Command())
    with Slam(CONFIG) as slam:
        pilot.steer(slam.take(tick))
    assert [pilot.ahead(Pose(x, 0.0, 0.0), k).speed for k, x in enumerate((0.0, 1.85))] == [0.5, 0.0]
    for pace, command in ((0.5, Command(0.25, 0.0)), (0.0, Command(0.0, TURN_RATE))):
        pilot.pace = pace
        assert pilot.ahead(Pose(), 99) == command  # and knows when the robot is back
