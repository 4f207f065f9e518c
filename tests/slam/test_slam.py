"""`Slam` fed by hand: what the loop makes of a world, and readings that change nothing."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import sixthsense as ss
from sixthsense.config import merge
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.result import SlamResult
from sixthsense.slam.slam import Slam

ESTIMATORS = ["ekf", "ekf-invariant", "isam2"]
START = Pose(1.0, 1.0, 0.3)


def circle_ticks(config: ss.Config, seconds: float) -> list[Tick]:
    """Ticks of a robot that drives a circle in the apartment."""
    scene = load_scene("apartment")
    assert scene.start is not None
    source = World(scene.walls, scene.start, scene.radius, config, np.random.default_rng(3))
    ticks = [source.step(Command(0.2, 0.5)) for _ in range(round(50 * seconds))]
    return [tick for tick in ticks if tick is not None]


def config_of(estimator: str) -> ss.Config:
    return ss.preset(scene="apartment", estimator=estimator)


def assert_same(one: SlamResult, two: SlamResult) -> None:
    assert np.array_equal(one.estimate.landmarks, two.estimate.landmarks)
    assert np.array_equal(one.joint_cov, two.joint_cov)
    assert np.array_equal(one.trajectory, two.trajectory)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_reading_changes_no_later_bit(estimator: str) -> None:
    config = config_of(estimator)
    ticks = circle_ticks(config, 12.0)
    with Slam(config, START) as quiet, Slam(config, START, draws_map=False) as read:
        for tick in ticks:
            quiet.take(tick)
            read.take(tick)
            estimate = read.estimate()
            estimate.landmarks[:] = np.nan
            read.trajectory()[:] = np.nan
            _ = read.pose, read.grid.occupancy(), read.estimator.joint_covariance(estimate.ids.tolist())
        assert len(quiet.trajectory()) > 5 and quiet.grid.seen.any() and not read.grid.seen.any()
        assert read.draw_map().seen.any()
        assert_same(quiet.finish(), read.finish())
        assert np.array_equal(quiet.grid.hits, read.grid.hits)


def test_scans_and_odometry_by_hand_give_what_ticks_give() -> None:
    config = config_of("ekf-invariant")
    ticks = circle_ticks(config, 6.0)
    with Slam(config, START) as by_tick, Slam(config, START) as by_hand:
        for tick in ticks:
            one = by_tick.take(tick)
            if tick.scan is None:
                two = by_hand.odometry(tick.stamp_ns, tick.odometry)
            else:
                two = by_hand.scan(tick.stamp_ns, tick.scan.ranges, tick.odometry)
            assert one.pose == two.pose
            assert (one.keyframe is None) == (two.keyframe is None)
        assert_same(by_tick.finish(), by_hand.finish())


def test_the_pose_between_keyframes_is_the_estimate_and_the_odometry_since() -> None:
    config = config_of("ekf")
    with Slam(config, START) as slam:
        for tick in circle_ticks(config, 4.0):
            step = slam.take(tick)
            assert slam.pose == step.pose
            if step.keyframe is not None:
                assert step.pose == slam.estimate().pose
                assert step.since.motion == Pose()
        last = Pose.from_array(slam.trajectory()[-1]) @ step.since.motion
        assert np.allclose(slam.finish().estimate.pose.array(), last.array(), atol=1e-12)


def test_a_start_that_is_not_exact_keeps_its_covariance_until_something_is_seen() -> None:
    cov = np.diag([0.04, 0.01, 0.02])
    with Slam(config_of("ekf-invariant"), START, start_cov=cov) as slam:
        assert np.allclose(slam.estimate().pose_cov, cov)


def test_blas_keeps_to_one_thread_inside_and_has_its_threads_back_after() -> None:
    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    before = threads()
    with Slam(config_of("ekf")):
        assert set(threads()) == {1}
    assert threads() == before


@pytest.mark.parametrize(("given", "radius_m"), [(None, 0.31), (0.0, 0.0), (0.27, 0.27)])
def test_the_robot_is_as_large_as_the_caller_says(given: float | None, radius_m: float) -> None:
    config = merge(config_of("ekf"), {"robot": {"radius": 0.31}})
    with Slam(config, radius_m=given) as slam:
        assert slam._radius_m == radius_m


@pytest.mark.parametrize("front_end", ["landmarks", "scan-matching"])
def test_a_keyframe_and_slam_state_one_covariance(front_end: str) -> None:
    config = merge(config_of("isam2"), {"front_end": front_end})
    with Slam(config, START) as slam:
        keyframes = 0
        for tick in circle_ticks(config, 4.0):
            step = slam.take(tick)
            if step.keyframe is not None:
                assert step.keyframe.index == keyframes
                assert np.array_equal(step.keyframe.estimate.pose_cov, slam.estimate().pose_cov)
                keyframes += 1
        assert keyframes > 5
        result = slam.finish()
    assert np.array_equal(result.joint_cov[:3, :3], result.estimate.pose_cov)


def test_what_cannot_be_taken_is_refused() -> None:
    config = config_of("ekf")
    with Slam(config) as slam:
        slam.scan(100, np.ones(360), Pose())
        with pytest.raises(ValueError, match=r"^ranges: expected shape \(360,\), got \(181,\)"):
            slam.scan(200, np.ones(181), Pose())
        with pytest.raises(ValueError, match=r"^ranges: expected shape \(360,\), got \(2, 360\)"):
            slam.scan(200, np.ones((2, 360)), Pose())
        metres = np.linspace(0.7, 5.9, 360)
        for ranges, found in ((np.full(360, np.nan), "NaN alone"), (1e3 * metres, "a median of 3")):
            with pytest.raises(ValueError, match=rf"^ranges: expected metres.*, got {found}"):
                slam.scan(200, ranges, Pose())
        slam.scan(150, np.where(metres < 4.0, 655.35, metres), Pose(0.1, 0.2, 0.3))  # a code for no return
        with pytest.raises(ValueError, match=r"^odometry: expected a Pose\(x, y, theta\), got an array of shape"):
            slam.scan(200, np.ones(360), np.zeros(3))
        with pytest.raises(ValueError, match=r"^odometry: expected finite numbers, got Pose\(x=nan"):
            slam.odometry(200, Pose(np.nan))
        with pytest.raises(ValueError, match=r"^stamp_ns: found 100 after 150"):
            slam.odometry(100, Pose())
        seen = {4: Observation(Kind.CORNER, np.array([1.7, -0.6]), 0.03 * np.eye(2))}
        scan = Scan.from_config(np.full(360, 2.3), config.laser)
        with pytest.raises(ValueError, match=r"^tick: found a scan and observations"):
            slam.take(Tick(200, Pose(0.3, 0.1, 0.2), scan, seen))
        with pytest.raises(ValueError, match=r"^stamp_ns: found 100 after 150"):
            slam.take(Tick(100, Pose(0.3, 0.1, 0.2)))
        slam.finish()
        with pytest.raises(RuntimeError, match="finish"):
            slam.odometry(300, Pose())
