"""Logs of wheels and of a camera that names landmarks: what is off in both is found while the robot drives."""

import math
from unittest.mock import patch

import numpy as np
from laws.nees import assert_consistent, error_of, normalised

from sixthsense.config import MotionNoise, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import polar_observation
from sixthsense.core.motion import Slip, rk4, slipped
from sixthsense.core.sensor import Sensor
from sixthsense.core.source import Tick
from sixthsense.slam.estimators import sensor_calibration
from sixthsense.slam.slam import Slam

PERIOD_S, FRAME = 0.05, 5
ANGLES = np.linspace(-np.pi, np.pi, 14, endpoint=False)
POINTS = np.column_stack([5.0 * np.cos(ANGLES), 4.0 * np.sin(ANGLES)])
CAMERA, DRIFT = Sensor(0.03, -0.02), 0.03
NOISE = {
    "motion": {"speed": 0.0, "turn_rate": 0.0, "slip_position_per_sqrt_m": 0.01, "slip_position_per_sqrt_rad": 0.005,
               "slip_heading_per_sqrt_m": 0.01, "slip_heading_per_sqrt_rad": 0.01},
    "laser": {"range_m": 0.03, "bearing_rad": 0.005},
}  # fmt: skip
SLIP = MotionNoise(**NOISE["motion"])


def command(time_s):
    """Forward speed and turn rate: straight, a left turn, straight, a shorter right turn."""
    phase = time_s % 12.0
    turn_rate = 0.5 if 3.0 <= phase < 6.5 else -0.4 if 9.0 <= phase < 10.0 else 0.0
    return 0.3, turn_rate


def camera_log(rng, duration_s, camera=CAMERA, drift=DRIFT):
    """Ticks with the robot's true pose, of wheels with a drift in rad per m."""
    odometry, true = Pose(), Pose()
    for k in range(round(duration_s / PERIOD_S)):
        observations = seen(true, camera, rng) if k % FRAME == 0 else {}
        yield Tick(round(1e9 * k * PERIOD_S), odometry, observations=observations, truth=true)
        odometry = rk4(odometry, *command(k * PERIOD_S), PERIOD_S)
        speed, turn_rate = command(k * PERIOD_S)
        true = rk4(true, speed, turn_rate + drift * speed, PERIOD_S)
        of_place, of_heading = slipped(Slip.of(SLIP), speed * PERIOD_S, turn_rate * PERIOD_S)
        true = true @ Pose(*(rng.standard_normal(3) * np.sqrt([of_place, of_place, of_heading])).tolist())


def seen(true, camera, rng):
    sigmas, found = (NOISE["laser"]["range_m"], NOISE["laser"]["bearing_rad"]), {}
    for i, point in enumerate(POINTS):
        x, y = camera.reported(true.inverse() @ point).tolist()
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        if abs(bearing) < 0.7:
            error = rng.standard_normal(2) * sigmas
            found[i] = polar_observation(distance + error[0], bearing + error[1], (sigmas[0] ** 2, sigmas[1] ** 2))
    return found


def without_scale():
    """The camera's scale is known in it, as that of its log is."""
    return patch.object(sensor_calibration, "SCALE_SIGMA", 0.0)


def run(ticks, **fields):
    """The result of a run, its error (3,) at the end, and the mean NEES over its keyframes."""
    assumed = {name: {**NOISE[name], **fields.pop(name, {})} for name in NOISE}
    with without_scale(), Slam(preset("mrclam", assumed=assumed, **fields)) as slam:
        for tick in ticks:
            slam.take(tick)
            true = tick.truth
        result = slam.finish()
    return result, error_of(result.estimate, true)


def test_the_drift_of_the_wheels_and_the_lens_of_the_camera_are_found():
    ticks = list(camera_log(np.random.default_rng(0), 60.0))
    result, error = run(ticks)
    wheels, sensor = result.wheels.with_sigmas(), result.sensor.with_sigmas()
    for name, (found, sigmas), true in (
        ("wheels", wheels, [0.0, 0.0, DRIFT]),
        ("sensor", sensor, CAMERA.array()),
    ):
        assert np.all(np.abs(found - true) < 3.5 * sigmas), name
    assert wheels[1, 2] < 0.01 and np.all(sensor[1] < 0.02)
    blind = run(ticks, calibrate_wheels=False, calibrate_sensor=False)[1]
    assert np.hypot(*error[:2]) < 0.15 and np.hypot(*error[:2]) < 0.5 * np.hypot(*blind[:2])


def test_pose_wheels_and_sensor_are_consistent_over_seeds():
    of_pose, of_all = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        camera = Sensor.from_array(0.03 * rng.standard_normal(2))
        result, error = run(camera_log(rng, 24.0, camera, 0.03 * rng.standard_normal()))
        of_pose.append(normalised(error, result.estimate.pose_cov))
        of_all.append(normalised(result.sensor.values.array() - camera.array(), result.sensor.cov))
    assert_consistent(of_pose, 3)
    assert_consistent(of_all, 2)


def test_where_nothing_is_off_estimating_it_costs_little():
    errors = {True: [], False: []}
    for seed in range(6):
        ticks = list(camera_log(np.random.default_rng(seed), 36.0, Sensor(), 0.0))
        for on_line in errors:
            error = run(ticks, calibrate_wheels=on_line, calibrate_sensor=on_line)[1]
            errors[on_line].append(np.hypot(*error[:2]))
    assert np.mean(errors[True]) < 1.5 * np.mean(errors[False]) + 0.01


def test_the_scale_of_a_camera_stays_uncertain_away_from_the_start():
    ticks = list(camera_log(np.random.default_rng(1), 20.0))
    config = preset("mrclam")
    with without_scale():
        without = Slam(config)
    with Slam(config) as with_scale, without:
        for tick in ticks:
            with_scale.take(tick)
            without.take(tick)
        more, less = with_scale.finish(), without.finish()
    n = len(more.estimate.ids)
    places = np.concatenate([more.estimate.pose.position, more.estimate.landmarks.ravel()])
    expected = np.zeros((3 + 2 * n, 3 + 2 * n))
    index = np.delete(np.arange(3 + 2 * n), 2)
    expected[np.ix_(index, index)] = 0.03**2 * np.outer(places, places)
    assert more.estimate.pose == less.estimate.pose
    assert np.allclose(more.joint_cov - less.joint_cov, expected, atol=1e-12)
    assert np.allclose(more.estimate.pose_cov, more.joint_cov[:3, :3])
