"""Landmarks whose matches are chosen where scan matching says that the robot is."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from laws.nees import slow_but
from rooms import CORNERS, RING, drive, ticks

from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.slam.slam import Slam

CONFIG = preset("log", front_end="landmarks", features={"landmarks": "both"})
POSES = drive(Pose(-9.0, -6.0, 0.0), CORNERS, step=0.2, turn=0.2)
TRUTH = np.array([pose.array() for pose in POSES])
SLIP_AT, SLIP = 180, Pose(0.0, 0.5, 0.3)


def slipping() -> Iterator[Tick]:
    """Ticks of a drive with bad wheels that slip once."""
    for k, tick in enumerate(ticks(POSES, RING, scale=1.03, drift=0.03)):
        yield dataclasses.replace(tick, odometry=tick.odometry @ (SLIP if k >= SLIP_AT else Pose()))


def errors(config: Config) -> Array:
    """(N,) position errors of the smoothed key poses and the odometry since."""
    since: list[tuple[int, Pose]] = []
    keys = -1
    with Slam(config, POSES[0]) as slam:
        for tick in slipping():
            step = slam.take(tick)
            keys += step.keyframe is not None
            since.append((keys, step.since.motion))
        result = slam.finish()
    poses = np.array([(Pose.from_array(result.trajectory[k]) @ motion).array() for k, motion in since])
    return np.asarray(np.hypot(*(poses - TRUTH)[:, :2].T))


@pytest.mark.parametrize("estimator", slow_but("ekf-invariant", ["isam2", "ekf-invariant"]))
def test_landmarks_survive_a_slip_where_aligned_scans_propose_the_pose(estimator: str) -> None:
    config = merge(CONFIG, {"estimator": estimator})
    found = errors(config)
    found[SLIP_AT : SLIP_AT + 3] = 0.0  # until the next keyframe the odometry is all that is known
    # Walls hold the pose: the ends of walls are seen from new sides, from places that are known to 5 cm.
    assert found.max() < 0.25 and np.sqrt(np.mean(found**2)) < 0.08
    assert errors(merge(config, {"association": {"proposed_by": "estimate"}})).max() > 3.0 * found.max()


def test_a_proposal_is_no_measurement() -> None:
    config = merge(CONFIG, {"features": {"lines": {"min_points": 400}, "points": {"min_points": 400}}})
    with Slam(config, POSES[0]) as slam:
        for tick in ticks(POSES[:120], RING, scale=1.05, drift=0.1):
            step = slam.take(tick)
        result = slam.finish()
    assert not len(result.estimate.ids) and result.loop_closures is not None
    assert np.allclose(step.pose.array(), step.dead_reckoned.array(), atol=1e-9)  # odometry alone
