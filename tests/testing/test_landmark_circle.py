"""The landmark circle: its evidence, its figures, and (slow) the estimators' honesty on it."""

import math

import numpy as np
import pytest

from sixthsense.config import ISAM2Config
from sixthsense.core.arcs import arc_jacobian, arc_length
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.motion import rk4
from sixthsense.evaluation.metrics import nees_band
from sixthsense.testing.circle import ODOMETRY_COV, RADIUS, follow, simulate

FILTERS = ("ekf", "ekf-invariant")


def arc_of(motion):
    return arc_length(*motion.triple()), motion.theta


def test_the_true_path_is_the_circle_without_noise():
    truth = simulate(0, 0, 480).truth
    np.testing.assert_allclose(np.hypot(truth[:, 0], truth[:, 1] - RADIUS), RADIUS)
    np.testing.assert_allclose(truth[239], np.zeros(3), atol=1e-9)  # once round in 240 steps
    first = Pose.from_array(truth[0])
    assert arc_of(first) == pytest.approx((0.25, math.radians(1.5)))
    step = rk4(Pose(), 0.25, math.radians(1.5), 1.0)
    assert math.dist(first.position, step.position) < 1e-9


def test_the_covariance_of_odometry_has_rank_two_after_one_step_and_three_after_two():
    evidence = simulate(0, 0, 3)
    for odometry in evidence.odometry:
        g = arc_jacobian(*arc_of(odometry.motion))
        np.testing.assert_allclose(odometry.cov, g @ ODOMETRY_COV @ g.T, atol=1e-15)
        assert np.linalg.matrix_rank(odometry.cov) == 2
    assert evidence.full_rank_from == 1 and np.isnan(follow("ekf", evidence).nees3).tolist() == [True, False, False]


@pytest.mark.parametrize("threshold", [0.1, 0.01])
def test_the_smoother_ends_near_the_invariant_filter(threshold):
    """Both see all evidence and lose none of it to an invented heading: they differ by less than they err."""
    evidence = simulate(2, 0, 300)
    smoother = follow("isam2", evidence, ISAM2Config(relinearize_threshold=threshold))
    invariant = follow("ekf-invariant", evidence)
    gap = np.abs(wrap_angle(smoother.heading - invariant.heading))
    assert np.sqrt(np.mean(gap**2)) < 0.2 * np.sqrt(np.mean(invariant.heading**2))


@pytest.mark.slow
def test_only_the_standard_filter_is_inconsistent():
    """40 whole runs of the filters, each band that of 40 runs."""
    evidence = [simulate(0, run) for run in range(40)]
    tracks = {name: [follow(name, own) for own in evidence] for name in FILTERS}
    rms = {name: math.sqrt(np.mean([track.position_m**2 for track in own])) for name, own in tracks.items()}
    for field, dof in (("nees3", 3), ("nees3_invariant", 3), ("nees_heading", 1)):
        low, high = nees_band(40, dof, confidence=0.999)
        found = {name: np.mean([np.nanmean(getattr(track, field)) for track in own]) for name, own in tracks.items()}
        assert found["ekf"] > high
        assert low < found["ekf-invariant"] < high and rms["ekf-invariant"] < 0.9 * rms["ekf"]
