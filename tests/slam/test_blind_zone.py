"""A robot that is not where it believes to be finds back, or at least knows that it is lost."""

import dataclasses
import math

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.core.geometry import Pose
from sixthsense.core.source import Command, Tick
from sixthsense.slam.association.blind_zone import BlindZone
from sixthsense.slam.slam import Slam
from sixthsense.sources.scene import load_scene
from sixthsense.sources.world import World


def test_only_scans_in_a_row_whose_observations_are_discarded_make_the_pose_uncertain() -> None:
    zone = BlindZone()
    assert [zone.uncertainty(matched=1, new=0, discarded=5) for _ in range(2)] == [None, None]
    assert zone.uncertainty(matched=5, new=0, discarded=1) is None
    assert [zone.uncertainty(matched=1, new=0, discarded=5) for _ in range(2)] == [None, None]
    first, second = (zone.uncertainty(matched=1, new=0, discarded=5) for _ in range(2))
    assert first is not None and second is not None
    assert first.motion == Pose()
    assert np.all(np.diag(second.cov) > 2.0 * np.diag(first.cov))


def test_scans_with_few_observations_do_not_end_the_blind_zone() -> None:
    zone = BlindZone()
    found = [zone.uncertainty(matched=0, new=0, discarded=count) for count in (5, 1, 5, 1, 5)]
    assert found[:4] == [None] * 4 and found[4] is not None


def pushed_ticks(config: ss.Config, at: int, push: Pose, seconds: float) -> list[Tick]:
    """Ticks of a robot that drives a circle in the apartment, and whose odometry jumps by `push` at tick `at`."""
    scene = load_scene("apartment")
    assert scene.start is not None
    source = World(scene.walls, scene.start, scene.radius, config, np.random.default_rng(3))
    ticks = [source.step(Command(0.1, 0.5)) for _ in range(round(50 * seconds))]
    kept = [tick for tick in ticks if tick is not None]
    jump = kept[at].odometry @ push @ kept[at].odometry.inverse()
    return [t if k < at else dataclasses.replace(t, odometry=jump @ t.odometry) for k, t in enumerate(kept)]


@pytest.mark.parametrize("estimator", ["ekf-invariant", "isam2"])
def test_a_robot_that_was_pushed_finds_back(estimator: str) -> None:
    config = ss.preset(scene="apartment", estimator=estimator)
    ticks = pushed_ticks(config, 600, Pose(0.15, 0.1, 0.08), 24.0)
    with Slam(config, ticks[0].truth) as slam:
        for tick in ticks:
            step = slam.take(tick)
    assert ticks[-1].truth is not None
    error = ticks[-1].truth.inverse() @ step.pose
    assert math.hypot(error.x, error.y) < 0.05
    assert abs(error.theta) < 0.02
