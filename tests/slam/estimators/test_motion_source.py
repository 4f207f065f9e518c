"""The motion that the last velocity predicts, and the time between scans that it is predicted over."""

from types import SimpleNamespace

import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.slam.estimators.motion_source import LastVelocity, scan_clock


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
