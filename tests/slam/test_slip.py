"""A robot that is not where it believes to be finds back, or at least knows that it is lost."""

import dataclasses
import math

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import propagated
from sixthsense.core.source import Command, Tick
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam


def pushed_ticks(config: ss.Config, at: int, push: Pose, seconds: float) -> list[Tick]:
    """Ticks of a robot that drives a circle in the apartment, and whose odometry jumps by `push` at tick `at`."""
    scene = load_scene("apartment")
    assert scene.start is not None
    source = World(scene.walls, scene.start, scene.radius, config, np.random.default_rng(3))
    ticks = [source.step(Command(0.1, 0.5)) for _ in range(round(50 * seconds))]
    kept = [tick for tick in ticks if tick is not None]
    jump = kept[at].odometry @ push @ kept[at].odometry.inverse()
    return [t if k < at else dataclasses.replace(t, odometry=jump @ t.odometry) for k, t in enumerate(kept)]


PUSHES = [Pose(0.15, 0.1, 0.08), Pose(0.6), Pose(0.0, 0.0, -0.15)]


def extents_after(config: ss.Config, push: Pose) -> dict[int, Array]:
    """Ends of the walls in the map of a robot that is pushed."""
    ticks = pushed_ticks(config, 600, push, 14.0)
    with Slam(config, ticks[0].truth) as slam:
        for tick in ticks:
            step = slam.take(tick)
    assert ticks[-1].truth is not None
    error = ticks[-1].truth.inverse() @ step.pose
    assert math.hypot(error.x, error.y) < 0.02 and abs(error.theta) < 0.02
    return {i: record.extent for i, record in slam.associator.records.items()}


@pytest.mark.parametrize("push", PUSHES)
@pytest.mark.parametrize("estimator", ["ekf-invariant", "isam2"])
def test_a_robot_that_was_pushed_finds_back(estimator: str, push: Pose) -> None:
    """At the next keyframe; without matches after a slip it would begin a second map beside the first."""
    config = ss.preset(scene="apartment", estimator=estimator)
    found, unpushed = extents_after(config, push), extents_after(config, Pose())
    assert len(found) <= 12  # ten are seen from the circle
    assert all(np.allclose(found[i], unpushed[i], atol=0.1) for i in found.keys() & unpushed.keys())


def test_a_robot_that_is_put_elsewhere_in_a_new_part_of_the_building_takes_what_it_sees_as_new() -> None:
    """No slip explains what it sees, and nothing is matched by force."""
    config = ss.preset(scene="apartment", estimator="ekf-invariant")
    ticks = pushed_ticks(config, 600, Pose(30.0, 0.0, 0.0), 14.0)
    with Slam(config, ticks[0].truth) as slam:
        slips = [k.association.slip for k in (slam.take(tick).keyframe for tick in ticks) if k is not None]
    assert not any(slips)


def test_a_slip_is_part_of_the_motion_that_is_recorded() -> None:
    """What a record, and a graph made of it, knows of the motion is all that the estimator was given."""
    config = ss.preset(scene="apartment", estimator="ekf")
    ticks = pushed_ticks(config, 600, Pose(0.6), 24.0)
    before, wide = None, 0
    with Slam(config, ticks[0].truth) as slam:
        for tick in ticks:
            keyframe = slam.take(tick).keyframe
            if keyframe is None:
                continue
            if before is not None:
                moved = propagated(before.estimate.pose, before.estimate.pose_cov, keyframe.motion)
                assert np.allclose(keyframe.predicted.pose_cov, moved, rtol=1e-6, atol=1e-12)
                wide += keyframe.association.slip is not None
            before = keyframe
    assert wide > 0
