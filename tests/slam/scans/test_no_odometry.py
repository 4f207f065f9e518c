"""Scan matching without odometry: the last velocity predicts, and its covariance is honest."""

import dataclasses

import numpy as np
import pytest
from rooms import CORNERS, RING, ROOM, drive, ticks

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.slam.scans import front_end, tracking
from sixthsense.slam.slam import Slam

CONFIG = preset(no_odometry=True)


def run(poses, walls, **changes):
    """The result, and the steps' poses; the ticks' odometry is nonsense."""
    with Slam(CONFIG, poses[0]) as slam:
        steps = []
        for tick in ticks(poses, walls):
            tick = dataclasses.replace(tick, odometry=Pose(float(tick.stamp_ns % 7), 0.0, 0.0), **changes)
            steps.append(slam.take(tick).pose.array())
        return slam.finish(), np.array(steps)


@pytest.mark.parametrize(
    ("start", "goals", "walls"),
    [
        (Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2), (-3, 1)], ROOM),
        (Pose(-9.0, -6.0, 0.0), CORNERS, RING),
    ],
)
def test_a_drive_is_tracked_without_its_odometry(start, goals, walls):
    poses = drive(start, goals)
    _, steps = run(poses, walls)
    off = steps - np.array([pose.array() for pose in poses])
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.1 and np.abs(wrap_angle(off[:, 2])).max() < 0.03


def test_a_scan_is_aligned_from_where_the_velocity_takes_the_last_one(monkeypatch):
    expectations = []

    def kept(*words):
        expectations.append(tracking.expected(*words))
        return expectations[-1]

    monkeypatch.setattr(front_end, "expected", kept)
    run(drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2)]), ROOM)
    starts = np.array([each.starts[0] - each.prior.pose for each in expectations])
    assert len(starts) > 50 and np.abs(starts).max() < 1e-6


def test_a_gap_of_the_clock_is_bridged():
    poses = drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2), (-3, 1)])
    with Slam(CONFIG, poses[0]) as slam:
        steps = [
            (k, slam.take(tick).pose.array())
            for k, tick in enumerate(ticks(poses, ROOM))
            if not len(poses) // 2 < k < len(poses) // 2 + 6
        ]
        off = np.array([pose - poses[k].array() for k, pose in steps])
    assert np.abs(off[-10:, :2]).max() < 0.05


def test_of_a_bare_corridor_the_covariance_says_that_the_motion_is_hidden():
    walls = np.array([[[-100, -1], [100, -1]], [[-100, 1], [100, 1]]], dtype=np.float64)
    poses = [Pose(0.05 * k, 0.0, 0.0) for k in range(100)]
    with Slam(CONFIG, poses[0]) as slam:
        for tick in ticks(poses, walls):
            slam.take(tick)
        slam.finish()
        estimate = slam.estimate()
    along, across, _ = np.sqrt(np.diag(estimate.pose_cov))
    assert abs(estimate.pose.x - poses[-1].x) < 3.0 * along
    assert across < 0.05 < along
