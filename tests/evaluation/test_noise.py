"""What a calibration is told by: errors, their gates, and the lines of its summary, by numpy on errors made by hand."""

import re

import numpy as np
import pytest

from sixthsense.config import AssumedConfig, Config, as_table, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.evaluation.calibrate import (
    Calibration,
    Errors,
    Sample,
    as_partial_config,
    calibrate,
    propagation_errors,
    summary,
)

RNG = np.random.default_rng(2)
ROOTS = np.eye(3) * [0.03, 0.02, 0.05] + RNG.uniform(-0.01, 0.01, (40, 3, 3))
COVS = ROOTS @ ROOTS.transpose(0, 2, 1)
ERRORS = RNG.normal(0.01, 0.03, (40, 3))
KINDS = np.where(np.arange(40) % 3, float(Kind.CORNER), float(Kind.END))


def made(scale):
    return Errors(scale * ERRORS, COVS, np.zeros(0)), Errors(scale * ERRORS[:, :2], COVS[:, :2, :2], KINDS)


def nees(errors, covs):
    return np.array([e @ np.linalg.inv(c) @ e for e, c in zip(errors, covs, strict=True)])


def test_the_mean_of_observations_is_of_those_within_the_gate():
    found, own = made(3.0)[1], nees(3.0 * ERRORS[:, :2], COVS[:, :2, :2])
    inside = own <= 13.816  # 99.9 % of chi-square with 2 degrees of freedom
    assert 5 < inside.sum() < 35
    assert found.mean_nees == pytest.approx(own[inside].mean())
    np.testing.assert_array_equal(found.of(Kind.END), 3.0 * ERRORS[::3, :2])


def test_errors_of_odometry_are_those_of_the_true_motion_in_the_axes_of_its_end_with_the_turn_wrapped():
    track = [Pose(0.4, 0.3, 2.0)]
    for _ in range(5):
        track.append(track[-1] @ Pose(0.02, 0.01, 0.62))
    whole = track[0].inverse() @ track[-1]
    truth = Pose(whole.x + 0.03, whole.y - 0.02, -3.0)
    found = propagation_errors([Sample(tuple(track), truth, Pose(), None)], AssumedConfig())
    c, s = np.cos(3.1), np.sin(3.1)
    assert found.errors[0] == pytest.approx([0.03 * c - 0.02 * s, -0.03 * s - 0.02 * c, 2.0 * np.pi - 3.0 - 3.1])


def test_the_summary_has_means_before_and_after_and_second_moments_about_zero():
    before, after = made(3.0), made(1.2)
    systematic = {"wheel_scale_error": (0.0123, 0.002), "drift_rad_per_m": (0.004, 0.003)}
    config = preset("worn")
    assumed = merge(config.assumed, {"wheel_scale_error": 0.0123, "drift_rad_per_m": 0.0})
    found = Calibration(assumed, systematic, (before[0], after[0]), (before[1], after[1]))
    lines = summary(found)
    numbers = [[float(one) for one in re.findall(r"(?<![\w^])-?\d+\.?\d*", line.replace("mm^2", ""))] for line in lines]
    scaled = [nees(scale * ERRORS, COVS).mean() for scale in (3.0, 1.2)]
    assert numbers[0] == pytest.approx([40, *scaled, 3], abs=0.005)
    assert lines[1:3] == ["wheel_scale_error: 0.0123 +- 0.0020, kept",
                          "drift_rad_per_m: 0.0040 +- 0.0030, set to 0: within 3 sigma"]  # fmt: skip
    assert numbers[3] == pytest.approx([40, before[1].mean_nees, 40, after[1].mean_nees, 2], abs=0.005)
    for k, kind in ((4, Kind.CORNER), (5, Kind.END)):
        mm = 1200.0 * ERRORS[kind == KINDS, :2]
        moment = sum(np.outer(row, row) for row in mm) / len(mm)
        assert numbers[k] == pytest.approx([len(mm), moment[0, 0], moment[0, 1], moment[1, 1]], abs=0.05)
    table = as_partial_config(found, config)
    assert merge(Config(), {"assumed": table["assumed"]}).assumed.motion == assumed.motion
    assert set(table["assumed"]) == {"wheel_scale_error", "drift_rad_per_m", "landmark_floor_m", "motion", "laser"}
    assert table["assumed"]["laser"]["range_m"] == as_table(assumed)["laser"]["range_m"]


def test_a_calibration_refuses_fewer_than_twenty_samples():
    with pytest.raises(InputError, match="samples: found 19, allowed: at least 20"):
        calibrate(preset(), 19)
