import math

import numpy as np
import pytest

from sixthsense.config import merge, preset
from sixthsense.core.geometry import Pose, point_segment_distance, wrap_angle
from sixthsense.core.source import Command
from sixthsense.sources.world import World

ROOM = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[2, 2], [-2, 2]], [[-2, 2], [-2, -2]]], dtype=float)


def world(config=None, start=None, walls=ROOM, radius=0.2, seed=0):
    return World(walls, start or Pose(), radius, config or preset("noiseless"), np.random.default_rng(seed))


def test_odometry_without_noise_is_the_truth():
    source = world(start=Pose(0.3, -0.2, 1.0))
    source.step(Command())
    for k in range(100):
        tick = source.step(Command(0.3, math.sin(0.1 * k)))
    assert np.allclose(tick.odometry.array(), tick.truth.array(), atol=1e-12)


def test_stamps_are_exact_nanoseconds_and_scans_have_their_period():
    source = world(preset("report"))
    ticks = [source.step(Command()) for _ in range(41)]
    assert [t.stamp_ns for t in ticks[:3]] == [0, 16_666_667, 33_333_334]
    assert [k for k, t in enumerate(ticks) if t.scan is not None] == [0, 10, 20, 30, 40]


def test_commands_are_clipped_to_the_limits_of_the_robot():
    source = world()
    source.step(Command())
    tick = source.step(Command(5.0, 0.0))
    assert tick.truth.x == pytest.approx(0.5 * 0.02)
    tick = source.step(Command(0.0, -9.0))
    assert tick.truth.theta == pytest.approx(-0.02)


def test_a_robot_that_hits_a_wall_stops_at_the_contact():
    source = world()
    while not (tick := source.step(Command(0.5, 0.0))).collided:
        assert point_segment_distance(tick.truth.position, ROOM).min() >= 0.2
    assert tick.truth.x == pytest.approx(1.8, abs=0.01) and tick.truth.x <= 1.8
    assert source.step(Command()) is None


def test_a_fast_robot_does_not_pass_a_thin_wall():
    config = merge(preset("noiseless"), {"robot": {"speed": 50.0, "control_period_s": 0.1, "integration_step_s": 0.1}})
    walls = np.concatenate([ROOM, [[[1.0, -1.0], [1.0, 1.0]]]])
    source = world(config, walls=walls, radius=0.05)
    source.step(Command())
    assert source.step(Command(50.0, 0.0)).collided


def test_the_whole_disc_collides_with_the_end_of_a_wall():
    walls = np.concatenate([ROOM, [[[0.5, 0.15], [0.5, 1.0]]]])
    source = world(walls=walls, radius=0.2)
    while not (tick := source.step(Command(0.5, 0.0))).collided:
        assert tick.truth.x < 0.5
    source = world(walls=walls, radius=0.14)
    assert not any(source.step(Command(0.5, 0.0)).collided for _ in range(60))


def test_the_seed_determines_the_world():
    def truth(seed):
        source = world(preset(), seed=seed)
        return [source.step(Command(0.2, 0.5)).truth.array() for _ in range(50)]

    assert np.array_equal(truth(1), truth(1))
    assert not np.array_equal(truth(1), truth(2))


@pytest.mark.parametrize("v, w", [(0.4, 0.0), (0.0, 0.8), (0.3, 0.6)])
def test_the_motion_noise_of_the_world_is_that_of_the_motion_model(v, w):
    """The spread of the truth about the odometry is the covariance that the increments fold to."""
    from sixthsense.core.motion import STANDSTILL, odometry

    config = preset()
    errors, cov = [], None
    for seed in range(600):
        source = world(config, seed=seed)
        before, folded = source.step(Command()).odometry, STANDSTILL
        for _ in range(50):
            tick = source.step(Command(v, w))
            if cov is None:
                folded = folded.then(odometry(before, tick.odometry, config.assumed))
            before = tick.odometry
        cov = folded.cov if cov is None else cov
        errors.append(tick.truth.array() - tick.odometry.array())
    errors = np.array(errors)
    errors[:, 2] = wrap_angle(errors[:, 2])
    nees = np.einsum("ij,jk,ik->i", errors, np.linalg.inv(cov), errors)
    assert 3 - 0.45 < nees.mean() < 3 + 0.45  # 600 runs: sigma of the mean is 0.1


def test_range_noise_has_the_configured_standard_deviation():
    source, scans = world(preset()), []
    while len(scans) < 200:
        tick = source.step(Command())
        if tick.scan is not None:
            scans.append(tick.scan.ranges.astype(float))
    assert np.std(scans, axis=0).mean() == pytest.approx(0.01, rel=0.03)


def test_glass_stops_the_robot_and_returns_nothing():
    walls = np.array([[[-5.0, 3.0], [5.0, 3.0]], [[-5.0, -3.0], [5.0, -3.0]]])
    glass = np.array([[[1.0, -3.0], [1.0, 3.0]]])
    config = preset(world={"laser": {"range_m": 0.0}})
    source = World(walls, Pose(), 0.2, config, np.random.default_rng(1), glass)
    clear = World(walls, Pose(), 0.2, config, np.random.default_rng(1))
    one, other = source.step(Command()), clear.step(Command())
    assert np.array_equal(one.scan.ranges, other.scan.ranges)
    while (tick := source.step(Command(0.5, 0.0))) is not None:
        last = tick
    assert last.collided
    assert last.truth.x == pytest.approx(0.8, abs=0.02)
