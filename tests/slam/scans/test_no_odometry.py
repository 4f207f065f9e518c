"""Scan matching without odometry: the last velocity predicts, and its covariance is honest."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from rooms import CORNERS, RING, ROOM, drive, ticks

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.slam.estimators.motion_source import LastVelocity, scan_clock
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


def predicted(velocity, duration_s, is_scan):
    """The motion of a tick with a scan, or without one."""
    return velocity.increment(Pose(), SimpleNamespace(scan=True if is_scan else None), duration_s)


def test_the_guess_grows_with_time_and_is_least_known_at_first():
    velocity = LastVelocity()
    first = predicted(velocity, 0.2, True)
    assert first.motion == Pose() and np.sqrt(first.cov[0, 0]) == pytest.approx(0.2, rel=0.1)
    parts, whole = LastVelocity(), LastVelocity()
    two = predicted(parts, 0.1, False).cov + predicted(parts, 0.1, False).cov
    np.testing.assert_allclose(two, predicted(whole, 0.2, False).cov, rtol=1e-9)


def test_of_a_guess_that_share_goes_on_which_the_time_since_the_velocity_was_known_makes():
    velocity = LastVelocity()
    velocity._cov = np.zeros((3, 3))  # known exactly, .5 s before the end and .2 s before the keyframe
    predicted(velocity, 0.2, False)
    velocity.begin_anew()
    since = STANDSTILL.then(predicted(velocity, 0.3, False))
    np.testing.assert_allclose(velocity.for_estimator(since).cov, (1.0 + 0.5 / 0.3) * since.cov, rtol=1e-9)


def test_a_laser_is_a_clock_whose_stamps_only_tell_of_gaps():
    period = scan_clock()
    rng = np.random.default_rng(0)
    periods = [period(stated) for stated in rng.choice([0.0, 0.4], 200)]
    assert np.abs(np.array(periods[100:]) - 0.2).max() < 0.1
    assert period(3.0) == 3.0


def test_what_a_scan_is_off_by_within_a_millisecond_is_no_velocity_of_metres_a_second():
    """The way of a millisecond is known better than any scan tells it: 4 mm are the scan's error."""
    velocity, cov, since = LastVelocity(), np.diag([9e-6, 9e-6, 4e-6]), STANDSTILL
    for k in range(1, 4):  # the robot moves at .5 m/s, a scan each .2 s
        since = since.then(predicted(velocity, 0.2, True))
        since = velocity.aligned(since, Odometry(Pose(0.1 * k, 0.0, 0.0), cov))
    for off in (0.004, -0.004):
        velocity.begin_anew()
        since = STANDSTILL.then(predicted(velocity, 1e-3, False))
        since = velocity.aligned(since, Odometry(Pose(since.motion.x + off, off, 0.0), cov))
        after = predicted(velocity, 0.2, False).motion
        assert np.hypot(after.x, after.y) < 0.3
