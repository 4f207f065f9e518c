import math
from pathlib import Path

import numpy as np
import pytest
from scanned import box

from sixthsense.config import AssumedConfig, Config, LaserConfig, merge, preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, odometry
from sixthsense.core.source import Command
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import nees_world
from sixthsense.logs.rosbag import read_bag
from sixthsense.logs.runfolder import read_run
from sixthsense.loop.run import replay, run
from sixthsense.record.exports import write_bag
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace
from sixthsense.simulation.world import World
from sixthsense.slam.features.deskew import Deskewer

ROOM = box(-2, -2, 4, 4)
SWEPT = preset("noiseless", laser={"sweep_s": 0.1, "mount": (0.1, -0.05, 0.3)})
ASSUMED = AssumedConfig()


def last_scan(config: Config, speed: float, turn_rate: float) -> tuple[Scan, Scan, Pose]:
    """The last scan of a second of driving, as taken and de-skewed, and the robot's true pose at its end."""
    world, deskew, before = World(ROOM, Pose(-0.5, 0.3, 0.4), 0.2, config, np.random.default_rng(0)), Deskewer(), None
    for _ in range(51):
        tick = world.step(Command(speed, turn_rate))
        assert tick is not None and tick.truth is not None
        deskew.moved(tick.stamp_ns, STANDSTILL if before is None else odometry(before, tick.odometry, ASSUMED))
        before = tick.odometry
    assert tick.scan is not None and tick.truth is not None
    return tick.scan, deskew(tick.scan), tick.truth


def off_walls(scan: Scan, truth: Pose) -> Array:
    points = truth @ scan.points_robot[np.isfinite(scan.ranges)]
    return np.array([point_segment_distance(point, ROOM).min() for point in points])


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.5, 0.0), (0.0, 1.0), (0.0, -1.0), (0.5, 1.0), (-0.3, -0.7)])
def test_a_scan_that_took_time_lies_on_the_walls_after_de_skewing_and_not_before(
    speed: float, turn_rate: float
) -> None:
    raw, moved, truth = last_scan(SWEPT, speed, turn_rate)
    assert off_walls(raw, truth).max() > 0.02
    assert off_walls(moved, truth).max() < 1e-4
    assert np.float32(moved.time_increment) == 0.0


def test_at_standstill_a_sweep_equals_an_instantaneous_scan() -> None:
    raw, moved, _ = last_scan(SWEPT, 0.0, 0.0)
    instant, _, _ = last_scan(merge(SWEPT, {"laser": {"sweep_s": 0.0}}), 0.0, 0.0)
    assert np.array_equal(raw.ranges, instant.ranges)
    assert np.allclose(moved.ranges, instant.ranges, atol=1e-6)
    assert np.allclose(moved.bearings, instant.bearings, atol=1e-9)
    assert moved.closed and instant.closed


def test_a_beam_that_measured_nothing_stays_one_without_a_return() -> None:
    deskew = Deskewer()
    for k in range(6):
        moved = Odometry(Pose(0.03, -0.01, 0.05), np.zeros((3, 3))) if k else STANDSTILL
        deskew.moved(20_000_000 * k, moved)
    assert not deskew(Scan.from_config(np.zeros(SWEPT.laser.beams), SWEPT.laser)).is_return.any()


def test_a_turning_robot_keeps_no_direction_twice_and_leaves_a_gap_open() -> None:
    for turn_rate, closed in ((1.0, True), (-1.0, False)):
        raw, moved, _ = last_scan(SWEPT, 0.0, turn_rate)
        assert moved.closed == closed
        span = moved.bearings[-1] - moved.bearings[0]
        spacing = float(raw.angle_increment)
        assert span + 0.49 * spacing < 2.0 * math.pi
        if closed:
            assert len(moved.ranges) < len(raw.ranges)
            assert 2.0 * math.pi - span < 2.0 * spacing


def test_the_noise_of_a_sweep_is_that_of_the_odometry_within_it() -> None:
    """De-skewed by noisy odometry, a far point has the error covariance of the sweep, scaled by its lag."""
    rng, errors, covs = np.random.default_rng(3), [], []
    step, cov = Pose(0.01, 0.0, 0.02), np.diag([1e-4, 1e-4, 2e-3]) ** 2
    config = LaserConfig(beams=360, sweep_s=0.1)
    for _ in range(300):
        deskew, true = Deskewer(), Pose()
        deskew.moved(0, STANDSTILL)
        for k in range(5):
            noise = Pose(*(np.sqrt(np.diag(cov)) * rng.standard_normal(3)))
            true = true @ step
            deskew.moved((k + 1) * 20_000_000, Odometry(step @ noise, cov))
        ranges = np.full(360, np.inf)
        ranges[10] = 4.0
        moved = deskew(Scan.from_config(ranges, config))
        point = moved.points_robot[np.isfinite(moved.ranges)][0]
        assert moved.sweep is not None
        lag = moved.sweep.lags[np.isfinite(moved.ranges)][0]
        by_motion = np.array([[1.0, 0.0, -point[1]], [0.0, 1.0, point[0]]])
        errors.append(point)
        covs.append(by_motion @ (lag * moved.sweep.cov) @ by_motion.T)
    spread, said = np.cov(np.array(errors).T), np.mean(covs, axis=0)
    across = np.array([-np.mean(errors, axis=0)[1], np.mean(errors, axis=0)[0]])
    across /= np.linalg.norm(across)
    assert across @ spread @ across == pytest.approx(across @ said @ across, rel=0.3)


def folder_of(config: Config, path: Path) -> tuple[Trace, Path]:
    folder = RunFolder(path, config)
    trace = run(config, folder.record)
    folder.write(trace, measure(trace))
    folder.finish()
    return trace, folder.out


def test_a_recorded_sweep_replays_exactly_and_states_its_begin(tmp_path: Path) -> None:
    config = preset(
        scene="rectangle", task="tour", max_time=6.0, laser={"sweep_s": 0.08}, features={"landmarks": "both"}
    )
    trace, out = folder_of(config, tmp_path / "run")
    log = read_run(out, config.laser)
    assert all(scan.time_increment == np.float32(0.08 / 360) for scan in log.scans)
    again = replay(log, config)
    assert np.abs(np.array(again.estimates) - np.array(trace.estimates)).max() < 1e-9
    write_bag(out / "bag", out, trace)
    foreign = read_bag(out / "bag", config.laser)
    scans = [tick for tick in foreign.ticks if tick.scan is not None]
    began = round(1e9 * 0.08 * 359 / 360)
    assert scans[5].log_stamp_s == pytest.approx(1e-9 * (trace.stamps_ns[5] - began), abs=1e-8)
    assert scans[5].stamp_ns == pytest.approx(trace.stamps_ns[5], abs=1)
    assert scans[5].scan is not None and scans[5].scan.time_increment == np.float32(0.08 / 360)


def test_with_a_sweep_the_estimate_is_consistent_only_if_de_skewed() -> None:
    figures = {}
    for on in (True, False):
        changes = {"laser": {"sweep_s": 0.1}, "features": {"landmarks": "both", "deskew": on}}
        nees = []
        for seed in range(2):
            config = preset(
                scene="rectangle", task="tour", max_time=15.0, seed=seed, estimator="ekf-invariant", **changes
            )
            trace = run(config)
            estimates = trace.key_estimates[5:]
            error = np.array([e.pose.array() for e in estimates]) - np.array(trace.key_truths)[5:]
            nees.append(nees_world(error, np.array([e.pose_cov for e in estimates])).mean())
        figures[on] = float(np.mean(nees))
    assert figures[True] < 5.0 < 20.0 < figures[False]
