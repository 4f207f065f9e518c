"""What a calibration is told by, and that it recovers the noise of a world."""

import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense.config import AssumedConfig, Config, as_table, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose, point_segment_distance, wrap_angle
from sixthsense.core.landmarks import Kind
from sixthsense.evaluation.calibrate import (
    PERIOD_S,
    Calibration,
    Errors,
    Sample,
    as_partial_config,
    calibrate,
    drive_samples,
    propagation_errors,
    summary,
)
from sixthsense.simulation.scene import load_scene

# Fewer ticks a second than usual, for speed.
COARSE = {"robot": {"control_period_s": 0.05}, "laser": {"period_ticks": 2}}
WORLDS = {
    "default": preset(**COARSE),
    "worn": preset("worn", **COARSE),
    "turns": preset(**COARSE, world={"motion": {"turn_rate": 0.4}}),
    "laser": preset(**COARSE, world={"laser": {"range_m": 0.03}}),
}


@pytest.fixture(scope="module")
def found() -> dict[str, Calibration]:
    return {name: calibrate(config) for name, config in WORLDS.items()}


def driven(config: Config, samples: int = 100):
    rngs = np.random.default_rng(config.seed).spawn(2)
    return drive_samples(config, samples, *rngs)


@pytest.mark.parametrize(("name", "scene"), [("default", "apartment"), ("worn", "office"), ("report", "rectangle")])
def test_the_calibration_drive_turns_left_and_moves(name: str, scene: str) -> None:
    config = preset(name, scene=scene)
    walls, samples = driven(config)
    radius = load_scene(scene).radius
    assert len(samples) == 100
    assert all(point_segment_distance(s.truth.position, walls).min() > radius for s in samples)
    turns = [wrap_angle(s.odometry[-1].theta - s.odometry[0].theta) for s in samples]
    assert min(turns) >= 0.0
    way = np.array([s.motion.x for s in samples])
    assert way.max() > 0.5 * config.robot.speed * PERIOD_S  # it does not only turn on the spot
    assert {len(s.odometry) - 1 for s in samples} == {round(PERIOD_S / config.robot.control_period_s)}


@pytest.mark.parametrize("name", WORLDS)
def test_nees_after_calibration_is_chi_square_distributed(found, name: str) -> None:
    """The likeliest covariance makes the mean NEES the dimension; single samples follow the distribution."""
    motion, landmarks = found[name].propagation[1], found[name].landmarks[1]
    assert motion.nees.mean() == pytest.approx(3.0, abs=0.15)
    assert 0.86 <= np.mean(motion.nees < chi2.ppf(0.95, 3)) <= 1.0
    assert landmarks.mean_nees == pytest.approx(2.0, abs=0.05)
    assert 0.90 <= np.mean(landmarks.nees < chi2.ppf(0.95, 2)) <= 0.99


def test_the_calibration_recovers_the_noise_of_the_world(found) -> None:
    turns, laser = found["turns"], found["laser"]
    assert turns.assumed.motion.turn_rate == pytest.approx(0.4, rel=0.25)
    assert turns.propagation[0].nees.mean() > 5.0
    assert laser.assumed.laser.range_m == pytest.approx(0.03, rel=0.15)
    assert laser.landmarks[0].mean_nees > 3.0
    assert found["default"].assumed.laser.range_m == pytest.approx(0.01, rel=0.1)


def test_drift_of_unequal_wheels_is_estimated() -> None:
    one = calibrate(preset(**COARSE, world={"drift_rad_per_m": 0.05}))
    assert one.assumed.drift_rad_per_m == pytest.approx(0.05, abs=0.02)
    assert one.assumed.wheel_scale_error == 0.0


def test_errors_beyond_the_range_noise_go_into_the_landmark_floor() -> None:
    one = calibrate(preset(**COARSE, world={"laser": {"bearing_rad": 0.03}}, features={"lines": {"threshold_m": 0.02}}))
    assert one.assumed.laser.range_m == 0.02
    assert one.assumed.landmark_floor_m > 0.0
    assert one.landmarks[1].mean_nees == pytest.approx(2.0, abs=0.2)


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


def test_the_summary_and_the_table_have_the_numbers_of_the_calibration():
    before, after = made(3.0), made(1.2)
    systematic = {"wheel_scale_error": (0.0123, 0.002), "drift_rad_per_m": (0.004, 0.003)}
    config = preset("worn")
    assumed = merge(config.assumed, {"wheel_scale_error": 0.0123, "drift_rad_per_m": 0.0})
    found = Calibration(assumed, systematic, (before[0], after[0]), (before[1], after[1]))
    lines = summary(found)
    scaled = [f"{nees(scale * ERRORS, COVS).mean():.2f}" for scale in (3.0, 1.2)]
    assert all(number in lines[0] for number in scaled)
    assert lines[1:3] == ["wheel_scale_error: 0.0123 +- 0.0020, kept",
                          "drift_rad_per_m: 0.0040 +- 0.0030, set to 0: within 3 sigma"]  # fmt: skip
    for line, kind in ((lines[4], Kind.CORNER), (lines[5], Kind.END)):
        mm = 1200.0 * ERRORS[kind == KINDS, :2]
        moment = sum(np.outer(row, row) for row in mm) / len(mm)  # about zero
        assert all(f"{moment[at]:.1f}" in line for at in ((0, 0), (0, 1), (1, 1)))
    table = as_partial_config(found, config)
    assert merge(Config(), {"assumed": table["assumed"]}).assumed.motion == assumed.motion
    assert table["assumed"]["laser"]["range_m"] == as_table(assumed)["laser"]["range_m"]


def test_a_calibration_refuses_fewer_than_twenty_samples():
    with pytest.raises(InputError, match="samples: found 19, allowed: at least 20"):
        calibrate(preset(), 19)
