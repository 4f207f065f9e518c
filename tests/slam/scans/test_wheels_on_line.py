"""The wheels' parameters on line with scan matching: found where scans observe them, kept where they do not."""

from dataclasses import replace

import numpy as np
import pytest
from rooms import CORNERS, CORRIDOR, HALF, RING, ROOM, drive, ticks

from sixthsense.config import AssumedConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.source import Tick
from sixthsense.core.wheels import Wheels, WheelTerms, wheel_prior
from sixthsense.slam.motion_source import UNSTEADY, ByWheels, with_wheel_errors
from sixthsense.slam.slam import Slam

CONFIG = preset(front_end="scan-matching", calibrate_wheels=True)
PRIOR = wheel_prior(CONFIG.assumed).with_sigmas()[1]


def wheels_after(poses, walls, **wheels):
    """(2, 3) the parameters and their sigmas."""
    with Slam(CONFIG, poses[0]) as slam:
        for tick in ticks(poses, walls, **wheels):
            slam.take(tick)
        result = slam.finish()
    assert result.wheels is not None
    return result.wheels.with_sigmas()


@pytest.mark.parametrize(("scale", "drift"), [(1.05, 0.03), (0.97, -0.02), (1.0, 0.0)])
def test_in_a_room_and_around_a_block_the_errors_are_found(scale, drift):
    for walls, way in ((RING, drive(Pose(-9.0, -6.0), CORNERS)), (ROOM, drive(Pose(-2, 1), [(0, 1), (0, -2)] * 3))):
        found, sigmas = wheels_after(way, walls, scale=scale, drift=drift)
        off = found[[0, 2]] - [1.0 / scale - 1.0, -drift]
        assert np.all(np.abs(off) < 3.5 * sigmas[[0, 2]]) and np.all(sigmas[[0, 2]] < 0.5 * PRIOR[[0, 2]])


def test_in_a_bare_corridor_the_forward_scale_is_hardly_learnt_and_the_drift_is():
    """Its axis is uncertain by some milliradians, so that many links say a little of the motion along it."""
    way = drive(Pose(-20.0, 0.2), [(20.0, 0.2)])
    found, sigmas = wheels_after(way, CORRIDOR, laser=HALF, scale=1.04, drift=0.02)
    truth = np.array([1.0 / 1.04 - 1.0, -0.02])
    assert sigmas[0] > 0.7 * PRIOR[0] and sigmas[2] < 0.2 * PRIOR[2]
    assert np.all(np.abs(found[[0, 2]] - truth) < 3.5 * sigmas[[0, 2]])


def test_errors_that_are_known_leave_what_no_parameter_describes():
    jacobian = np.diag([0.25, 0.0, 0.25])
    odometry = Odometry(Pose(0.25, 0.0, 0.0), 1e-6 * np.eye(3), WheelTerms(Wheels(), jacobian))
    sigmas = ([0.0] * 3, [0.05, 0.0, 0.03])
    known, unknown = (ParameterEstimate(Wheels(), np.diag(each) ** 2) for each in sigmas)
    sources = [ByWheels(AssumedConfig(), wheels) for wheels in (None, known, unknown)]
    of_any, of_known, of_unknown = (source.for_tracking(odometry).cov for source in sources)
    assert np.array_equal(of_known, with_wheel_errors(odometry, share=UNSTEADY).cov)
    assert np.allclose(of_unknown - of_known, np.diag([0.0125, 0.0, 0.0075]) ** 2)
    assert np.all(np.diag(of_known) < np.diag(of_any))
    left = sources[2].for_estimator(odometry)
    assert left.wheels is odometry.wheels and np.array_equal(left.cov, of_known)


def test_a_covariance_that_the_log_states_is_not_enlarged():
    stated = Tick(7, Pose(1.2, 0.3, 0.4), increment_cov=1e-5 * np.eye(3))
    for source in (ByWheels(AssumedConfig()), ByWheels(AssumedConfig(), wheel_prior(AssumedConfig()))):
        for is_stated in (True, False):
            tick = stated if is_stated else replace(stated, increment_cov=None)
            moved = source.increment(Pose(1.0, 0.2, 0.3), tick, 0.1)
            for found in (source.for_estimator(moved), source.for_tracking(moved)):
                assert np.array_equal(found.cov, moved.cov) == is_stated


def test_what_is_reported_between_keyframes_is_what_the_next_keyframe_is_given():
    way = drive(Pose(-2, 1), [(0, 1), (0, -2)])
    before, jumps = None, []
    with Slam(preset(front_end="scan-matching"), way[0]) as slam:
        for tick in ticks(way, ROOM, scale=1.05):
            step = slam.take(tick)
            if step.keyframe is not None and before is not None and before.motion.position.any():
                jumps.append(np.sqrt(np.diag(step.keyframe.motion.cov) / np.diag(before.cov)))
            before = step.since
            assert before.motion.position.any() or not before.cov.any()  # nothing is lost at a standstill
    assert len(jumps) > 10 and np.median(jumps, axis=0).max() < 1.4
