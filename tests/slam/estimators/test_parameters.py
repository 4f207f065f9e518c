"""Parameters of wheels and sensor on line: NEES of pose and parameters, and runs."""

import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised, slow_but
from laws.parameters import KINDS

import sixthsense as ss
from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.config.parts import FILTERS
from sixthsense.core.geometry import Pose
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.estimators.sensor_calibration import SCALE_SIGMA, SensorCalibration


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.label)
@pytest.mark.parametrize("name", slow_but("ekf-invariant", FILTERS))
def test_with_values_from_the_prior_pose_and_parameters_are_consistent(name, kind):
    """Each run with other values."""
    of_pose, of_parameters = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = kind.drawn(rng)
        estimator, true = kind.driven(name, 40, 0.01, rng, values)
        estimate, found = estimator.estimate(), kind.found(estimator)
        of_pose.append(normalised(error_of(estimate, true), estimate.pose_cov))
        of_parameters.append(normalised(found.values.array() - values.array(), found.cov))
    assert_consistent(of_pose, 3)
    assert_consistent(of_parameters, len(kind.prior.cov))


def test_a_run_with_worn_wheels_finds_their_errors_and_its_folder_keeps_them(tmp_path):
    fields = {"scene": "rectangle", "task": "tour", "max_time": 25.0, "estimator": "ekf-invariant"}
    config = preset("worn", **fields, calibrate_wheels=True)
    run = ss.run(config, out=tmp_path / "run")
    for key, sigma in zip(("forward_scale", "turn_scale"), run.trace.wheels[1], strict=False):
        assert abs(run.metrics[f"wheel_{key}_error"] - 0.02) < 3.5 * sigma and sigma < 0.03
    assert np.array_equal(ss.load(tmp_path / "run").trace.wheels, run.trace.wheels)


def test_a_scale_that_is_not_known_moves_all_from_the_start_by_its_share_of_the_way_there():
    config, start = preset("mrclam", calibrate_sensor=True), Pose(1.3, -0.7, 0.4)
    sensor = SensorCalibration(config, EKF(start, np.zeros((3, 3))), start)
    places, cov = np.array([2.1, 0.6, -1.5, 3.2]), np.diag([0.1, 0.2, 0.3, 0.4, 0.5])
    moved = (np.array([[2.1, 0.6], [-1.5, 3.2]]) - start.position) * SCALE_SIGMA
    off = np.array([*moved[0], 0.0, *moved[1]])
    assert sensor.reported_joint(places, cov) == pytest.approx(cov + np.outer(off, off), abs=1e-12)


class Points:
    """An estimator of a user's, with the six methods that association and update need."""

    def __init__(self, start, start_cov):
        self._own = EKF(start, start_cov)

    def __getattr__(self, name):
        if name in ("predict", "update", "forget", "estimate", "joint_covariance", "trajectory"):
            return getattr(self._own, name)
        raise AttributeError(name)


@pytest.mark.parametrize("estimator", [Points, "isam2"])
def test_an_estimator_without_wheels_is_told_where_they_are_asked_for(estimator):
    with pytest.raises(InputError, match=r"calibrate_wheels: found true with .*, allowed: ekf-invariant, ekf, or one"):
        ss.run("rectangle", estimator=estimator, calibrate_wheels=True, task="tour", max_time=1.0)
