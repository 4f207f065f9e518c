import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense.config import Config, preset
from sixthsense.core.geometry import point_segment_distance, wrap_angle
from sixthsense.evaluation.calibrate import PERIOD_S, Calibration, calibrate, drive_samples
from sixthsense.running.warmup import warm_up
from sixthsense.simulation.scene import load_scene

# Fewer ticks a second than usual, for speed.
COARSE = {"robot": {"control_period_s": 0.05}, "laser": {"period_ticks": 2}}
WORLDS = {
    "default": preset(**COARSE),
    "worn": preset("worn", **COARSE),
    "turns": preset(**COARSE, world={"motion": {"turn_rate": 0.4}}),
    "laser": preset(**COARSE, world={"laser": {"range_m": 0.03}}),
}


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    warm_up()


@pytest.fixture(scope="module")
def found() -> dict[str, list[Calibration]]:
    return {name: [calibrate(c.replaced(seed=s)) for s in range(2)] for name, c in WORLDS.items()}


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
    for one in found[name]:
        motion, landmarks = one.propagation[1], one.landmarks[1]
        assert motion.nees.mean() == pytest.approx(3.0, abs=0.15)
        assert 0.86 <= np.mean(motion.nees < chi2.ppf(0.95, 3)) <= 1.0
        assert landmarks.mean_nees == pytest.approx(2.0, abs=0.05)
        assert 0.90 <= np.mean(landmarks.nees < chi2.ppf(0.95, 2)) <= 0.99


def test_the_calibration_recovers_the_noise_of_the_world(found) -> None:
    for one in found["turns"]:
        assert one.assumed.motion.turn_rate == pytest.approx(0.4, rel=0.25)
        assert one.propagation[0].nees.mean() > 5.0
    for one in found["laser"]:
        assert one.assumed.laser.range_m == pytest.approx(0.03, rel=0.15)
        assert one.landmarks[0].mean_nees > 3.0
    for one in found["default"]:
        assert one.assumed.laser.range_m == pytest.approx(0.01, rel=0.1)


def test_drift_of_unequal_wheels_is_estimated() -> None:
    one = calibrate(preset(**COARSE, world={"drift_rad_per_m": 0.05}))
    assert one.assumed.drift_rad_per_m == pytest.approx(0.05, abs=0.02)
    assert one.assumed.wheel_scale_error == 0.0


def test_errors_beyond_the_range_noise_go_into_the_landmark_floor() -> None:
    one = calibrate(preset(**COARSE, world={"laser": {"bearing_rad": 0.03}}, features={"lines": {"threshold_m": 0.02}}))
    assert one.assumed.laser.range_m == 0.02
    assert one.assumed.landmark_floor_m > 0.0
    assert one.landmarks[1].mean_nees == pytest.approx(2.0, abs=0.2)
