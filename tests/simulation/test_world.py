import math

import numpy as np
import pytest
from scanned import box
from scipy import stats

from sixthsense.config import InputError, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.simulation.world import World

LOW, HIGH = (-3.0, -2.0), (4.5, 5.5)
ROOM = box(*LOW, 7.5, 7.5)
START = Pose(0.7, 0.4, 0.6)
MOUNT = (0.23, -0.17, 1.1)
LASER = {"beams": 97, "fov": 4.1, "max_range": 5.2, "mount": MOUNT, "period_ticks": 5}


def world(config=None, start=START, walls=ROOM, radius=0.2, seed=3):
    return World(walls, start, radius, config or preset("noiseless"), np.random.default_rng(seed))


def driven(source, *commands, ticks=1):
    """The tick after each of `ticks` times these commands, the first one at the start included."""
    found = [source.step(Command())]
    for command in commands * ticks:
        found.append(source.step(Command(*command)))
    return found


def to_sides(x: Array, y: Array, direction: Array) -> Array:
    """Closed form: the ray leaves the room through the nearer of the sides that it runs towards."""
    c, s = np.cos(direction), np.sin(direction)
    to_x = (np.where(c > 0.0, HIGH[0], LOW[0]) - x) / c
    to_y = (np.where(s > 0.0, HIGH[1], LOW[1]) - y) / s
    return np.minimum(to_x, to_y)


def expected_ranges(truths: Array, bearings: Array, max_range: float = 5.2) -> Array:
    """Of the laser on a robot at poses (N, 3), a beam each."""
    x, y, theta = truths.T
    c, s = np.cos(theta), np.sin(theta)
    place = x + c * MOUNT[0] - s * MOUNT[1], y + s * MOUNT[0] + c * MOUNT[1]
    ranges = to_sides(*place, theta + MOUNT[2] + bearings)
    return np.where(ranges < max_range, ranges, np.inf)


BEARINGS = -2.05 + 4.1 / 96 * np.arange(97)


@pytest.mark.parametrize(("sweep_s", "max_range"), [(0.0, 5.2), (0.07, 30.0)])
def test_each_beam_of_a_laser_aside_and_turned_is_taken_where_the_robot_was_at_its_time(sweep_s, max_range):
    config = preset("noiseless", laser={**LASER, "sweep_s": sweep_s, "max_range": max_range})
    ticks = driven(world(config), (0.4, 0.6), (-0.3, 0.5), (0.5, -0.9), ticks=20)
    scans = [k for k, tick in enumerate(ticks) if tick.scan is not None]
    assert len(scans) == 13 and ticks[-1].truth.theta != ticks[0].truth.theta
    for k in scans[1:]:
        times, found = ticks[k].scan.times_s, ticks[k].scan.ranges
        assert times == pytest.approx(sweep_s * (np.arange(97) - 96) / 97)
        stamps = np.array([1e-9 * (tick.stamp_ns - ticks[k].stamp_ns) for tick in ticks[: k + 1]])
        truths = np.array([tick.truth.array() for tick in ticks[: k + 1]])
        at = np.column_stack([np.interp(times, stamps, np.unwrap(column)) for column in truths.T])
        np.testing.assert_allclose(found, expected_ranges(at, BEARINGS, max_range), atol=3e-5)
        assert ticks[k].scan.T_robot_laser == Pose(*MOUNT) and (5 < np.isinf(found).sum() < 90) == (max_range == 5.2)


@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_the_noise_of_the_laser_has_its_distribution_in_range_and_bearing(distribution):
    laser, truths, turn = {**LASER, "period_ticks": 1, "max_range": 30.0}, np.tile(START.array(), (97, 1)), 1e-5
    before, expected, after = (expected_ranges(truths, BEARINGS + k * turn, 30.0) for k in (-1, 0, 1))
    slope = (after - before) / (2.0 * turn)
    on_one_wall = np.abs(np.diff(slope, prepend=np.inf)) + np.abs(np.diff(slope, append=np.inf)) < 1.0
    beams = np.flatnonzero(on_one_wall & (np.abs(slope) > 0.5))[[0, 10, 20]]
    assert len(set(np.sign(slope[beams]))) == 2
    shape = stats.norm(0.0, 1.0) if distribution == "gaussian" else stats.uniform(-1.0, 2.0)
    for noise, scale in (({"range_m": 0.02}, 0.02), ({"bearing_rad": 0.003}, 0.003 * slope)):
        source = world(preset("noiseless", laser=laser, world={"laser": {"distribution": distribution, **noise}}))
        ranges = np.array([tick.scan.ranges for tick in driven(source, (0.0, 0.0), ticks=400)])
        for errors in ((ranges - expected) / scale).T[beams]:
            assert stats.kstest(errors, shape.cdf).pvalue > 1e-3


NO_SLIP = {f"slip_{what}_per_sqrt_{unit}": 0.0 for what in ("position", "heading") for unit in ("m", "rad")}


def errors_of(motion, commands, ticks, seed_count=1500, **errors):
    """(N, 3) truth in the frame of odometry after one scan's ticks, and that odometry's motion."""
    config = preset("noiseless", world={"motion": {**NO_SLIP, "speed": 0.0, "turn_rate": 0.0, **motion}, **errors})
    found = []
    for seed in range(seed_count):
        last = driven(world(config, seed=seed), commands, ticks=ticks)[-1]
        found.append((last.odometry.inverse() @ last.truth).array())
    return np.array(found), START.inverse() @ last.odometry


def test_speed_and_turn_rate_have_noise_of_their_own_in_each_tick():
    straight, _ = errors_of({"speed": 0.2, "turn_rate": 0.4}, (0.5, 0.0), 4)
    assert straight[:, 0].std() == pytest.approx(0.2 * 0.5 * 0.02 * 2.0, rel=0.06)
    assert np.abs(straight[:, 1:]).max() < 1e-12
    turn, _ = errors_of({"speed": 0.2, "turn_rate": 0.4}, (0.0, 0.7), 4)
    assert turn[:, 2].std() == pytest.approx(0.4 * 0.7 * 0.02 * 2.0, rel=0.06)
    both, _ = errors_of({"speed": 0.2, "turn_rate": 0.4, "distribution": "uniform"}, (0.5, 0.7), 1)
    speed, rate = both[:, 0] / (0.5 * 0.02), both[:, 2] / (0.7 * 0.02)
    assert stats.kstest(speed, stats.uniform(-0.2, 0.4).cdf).pvalue > 1e-3
    assert stats.kstest(rate, stats.uniform(-0.4, 0.8).cdf).pvalue > 1e-3
    assert abs(stats.pearsonr(speed, rate).statistic) < 0.1


def test_slip_grows_with_the_root_of_distance_and_turn_and_is_that_of_each_axis():
    motion = {"slip_position_per_sqrt_m": 0.03, "slip_heading_per_sqrt_m": 0.05, "slip_position_per_sqrt_rad": 0.02,
              "slip_heading_per_sqrt_rad": 0.07}  # fmt: skip
    for command in ((0.5, 0.0), (0.0, -0.9), (-0.4, 0.8)):
        errors, _ = errors_of(motion, command, 4)
        distance, turn = abs(command[0]) * 0.08, abs(command[1]) * 0.08
        position = math.sqrt(0.03**2 * distance + 0.02**2 * turn)
        heading = math.sqrt(0.05**2 * distance + 0.07**2 * turn)
        assert errors.std(axis=0) == pytest.approx([position, position, heading], rel=0.06)
        assert abs(stats.pearsonr(errors[:, 0], errors[:, 1]).statistic) < 0.1


def test_worn_wheels_drive_and_turn_more_than_they_report_and_drift():
    errors, motion = errors_of({}, (0.4, 0.6), 50, 1, wheel_scale_error=0.1, drift_rad_per_m=0.5)
    v, w = 1.1 * 0.4, 1.1 * 0.6 + 0.5 * 1.1 * 0.4
    arc = Pose(v / w * math.sin(w), v / w * (1.0 - math.cos(w)), w)
    assert errors[0] == pytest.approx((motion.inverse() @ arc).array(), abs=1e-6)


def test_the_first_step_moves_nothing_and_commands_are_clipped_to_the_limits_of_the_robot():
    config = preset("noiseless", robot={"speed": 0.5, "turn_rate": 0.8})
    first = world(config).step(Command(0.4, 0.5))
    assert first.truth == first.odometry == START and first.scan is not None
    for command, speed, rate in (
        ((5.0, 0.0), 0.5, 0.0), ((-5.0, 0.0), -0.5, 0.0), ((0.0, -9.0), 0.0, -0.8), ((0.0, 9.0), 0.0, 0.8),
    ):  # fmt: skip
        moved = START.inverse() @ driven(world(config), command)[-1].truth
        assert (moved.x, moved.theta) == (pytest.approx(speed * 0.02), pytest.approx(rate * 0.02))
    with pytest.raises(InputError, match=r"command: found .*nan.*, allowed: a finite speed and turn rate"):
        world(config).step(Command(0.1, math.nan))


def test_a_fast_robot_does_not_pass_a_thin_wall_and_is_not_stopped_by_one_beside_its_way():
    config = preset("noiseless", robot={"speed": 50.0, "control_period_s": 0.05})
    for low, high, is_hit in ((-0.3, 0.6, True), (0.6, 1.2, False), (-1.2, -0.3, False)):
        ends = START @ np.array([[1.0, low], [1.2, high]])
        source = world(config, walls=np.concatenate([ROOM, ends[None]]), radius=0.05)
        assert driven(source, (50.0, 0.0))[-1].collided == is_hit


def test_glass_stops_the_robot_and_returns_nothing():
    config = preset("noiseless", laser=LASER)
    glass = (START @ np.array([[1.0, -0.8], [1.0, 0.9]]))[None]
    source = World(ROOM, START, 0.2, config, np.random.default_rng(1), glass)
    first, clear = source.step(Command()), world(config).step(Command())
    assert np.array_equal(first.scan.ranges, clear.scan.ranges)
    while (tick := source.step(Command(0.5, 0.0))) is not None:
        last = tick
        assert (START.inverse() @ last.truth).x <= 0.8
    assert last.collided and (START.inverse() @ last.truth).x == pytest.approx(0.8, abs=0.02)
