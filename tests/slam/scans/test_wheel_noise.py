"""How large the errors of the wheels are in a run."""

import numpy as np
import pytest

from sixthsense.core.geometry import rotation
from sixthsense.slam.scans.tracking import WheelNoise

STATED = np.diag([0.03, 0.04, 0.02]) ** 2
HEADING = 0.8


def learned(position, heading, slips=0.0, motions=1500, seed=3):
    """The noise after motions whose errors are these factors larger than stated, and which scans measure."""
    rng, noise = np.random.default_rng(seed), WheelNoise()
    scans = np.diag([0.01, 0.015, 0.004]) ** 2
    for _ in range(motions):
        now = STATED * np.outer(noise.factors, noise.factors)
        truth = rng.normal(size=3) * np.sqrt(np.diag(STATED)) * [position, position, heading]
        if rng.uniform() < slips:
            truth = rng.normal(size=3) * [0.4, 0.4, 0.3]
        seen = truth + rng.multivariate_normal(np.zeros(3), scans)
        left = np.linalg.inv(np.linalg.inv(now) + np.linalg.inv(scans))
        turn = np.eye(3)
        turn[:2, :2] = rotation(HEADING)
        noise.update(STATED, turn @ left @ np.linalg.inv(scans) @ seen, turn @ left @ turn.T, HEADING)
    return noise.factors


@pytest.mark.parametrize(("position", "heading"), [(0.3, 2.0), (1.6, 0.4)])
def test_wheels_that_are_better_or_worse_than_wheels_in_general_are_found_out(position, heading):
    found = np.mean([learned(position, heading, seed=seed) for seed in range(5)], axis=0)
    # The core of a normal distribution, fitted by Student's with four degrees of freedom, is some 15 % narrower.
    assert found == pytest.approx([position, position, heading], rel=0.3)


def test_a_few_slips_say_little_of_the_other_motions():
    clean, slipping = learned(0.5, 0.7), learned(0.5, 0.7, slips=0.03)
    assert slipping == pytest.approx(clean, rel=0.35)
