"""How large the errors of the wheels are in a run, and what of them is reported."""

from dataclasses import replace

import numpy as np
import pytest
from rooms import ROOM, drive, ticks

from sixthsense.config import AssumedConfig, preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.source import Tick
from sixthsense.slam.estimators.motion_source import ByWheels
from sixthsense.slam.scans.tracking import WheelNoise
from sixthsense.slam.slam import Slam

STATED = np.diag([0.03, 0.04, 0.02]) ** 2
HEADING = 0.8


def learned(position, heading, slips=0.0, motions=1500, seed=3):
    """The noise after motions whose errors are these factors larger than stated, and which scans measure."""
    rng, noise = np.random.default_rng(seed), WheelNoise()
    scans = np.diag([0.01, 0.015, 0.004]) ** 2
    for _ in range(motions):
        now = STATED * noise.factors
        truth = rng.normal(size=3) * np.sqrt(np.diag(STATED)) * [position, position, heading]
        if rng.uniform() < slips:
            truth = rng.normal(size=3) * [0.4, 0.4, 0.3]
        seen = truth + rng.multivariate_normal(np.zeros(3), scans)
        left = np.linalg.inv(np.linalg.inv(now) + np.linalg.inv(scans))
        turn = np.eye(3)
        turn[:2, :2] = rotation(HEADING)
        noise.update(STATED, turn @ left @ np.linalg.inv(scans) @ seen, turn @ left @ turn.T, HEADING)
    return np.sqrt(np.diag(noise.factors))


@pytest.mark.parametrize(("position", "heading"), [(0.3, 2.0), (1.6, 0.4)])
def test_wheels_that_are_better_or_worse_than_wheels_in_general_are_found_out(position, heading):
    found = np.mean([learned(position, heading, seed=seed) for seed in range(5)], axis=0)
    # The core of a normal distribution, fitted by Student's with four degrees of freedom, is some 15 % narrower.
    assert found == pytest.approx([position, position, heading], rel=0.3)


def test_a_few_slips_say_little_of_the_other_motions():
    clean, slipping = learned(0.5, 0.7), learned(0.5, 0.7, slips=0.03)
    assert slipping == pytest.approx(clean, rel=0.35)


def test_a_covariance_that_the_log_states_is_not_enlarged():
    stated = Tick(7, Pose(1.2, 0.3, 0.4), increment_cov=1e-5 * np.eye(3))
    source = ByWheels(AssumedConfig())
    for tick in (stated, replace(stated, increment_cov=None)):
        moved = source.increment(Pose(1.0, 0.2, 0.3), tick, 0.1)
        assert np.array_equal(source.for_estimator(moved).cov, moved.cov) == (tick is stated)


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
