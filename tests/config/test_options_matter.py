"""Every option has its documented effect: a test for each option that no other test covers."""

import math

import numpy as np
import pytest

from sixthsense.config import AssociationConfig, PartitionConfig, merge, preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Command, Tick
from sixthsense.evaluation.measure import measure
from sixthsense.loop import replay
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.features import extract
from sixthsense.slam.features.endpoints import free_end
from sixthsense.slam.features.partition import partition
from sixthsense.slam.mapping.grid import Grid
from sixthsense.sources.logs.log import Log
from sixthsense.sources.world import World

ROOM = np.array([[[-3, -2], [3, -2]], [[3, -2], [3, 2]], [[3, 2], [-3, 2]], [[-3, 2], [-3, -2]],
                 [[1, -2], [1, -0.5]]], dtype=float)  # fmt: skip


def features_at(config, T_world_laser=None):
    """Features of a noise-free scan; the laser has the same pose for any mount."""
    pose = T_world_laser or Pose(-0.5, 0.3, 0.4)
    ranges = cast_rays(pose, beam_bearings(config.laser), ROOM, config.laser.max_range)
    scan = Scan.from_config(ranges, config.laser)
    return extract(scan, config.assumed, config.features, np.random.default_rng(0))


def test_the_mount_rotates_the_covariance_with_the_observation():
    corners = {"features": {"landmarks": "corners"}}
    plain = features_at(preset(**corners)).observations
    mount = (0.2, -0.1, 1.1)
    turned = features_at(preset(laser={"mount": mount}, **corners)).observations
    assert len(plain) == len(turned) > 4
    for a, b in zip(plain, turned, strict=True):
        assert np.allclose(Pose(*mount) @ a.z, b.z, atol=1e-9)
        assert np.allclose(rotation(1.1) @ a.cov @ rotation(1.1).T, b.cov, atol=1e-15)


def test_the_floor_of_landmarks_adds_to_every_observation():
    corners = {"features": {"landmarks": "corners"}}
    plain, floored = (features_at(preset(assumed={"landmark_floor_m": f}, **corners)).observations for f in (0.0, 0.05))
    for a, b in zip(plain, floored, strict=True):
        assert np.allclose(a.cov + 0.0025 * np.eye(2), b.cov, atol=1e-12)


def test_bearing_noise_increases_the_variance_of_a_free_end_along_its_wall():
    line = np.array([0.0, 2.0, 0.0, 0.0, 0.0])
    sure, unsure = (free_end(line, 0.3, 0.02, sigma) for sigma in (0.0, 0.01))
    along = 2.0 / math.cos(0.31) ** 2  # d(y)/d(bearing) on the wall x = 2
    assert unsure[4] - sure[4] == pytest.approx((0.01 * along) ** 2, rel=1e-6)


def test_the_margin_below_the_maximum_range_hides_free_ends():
    def ends(margin):
        config = preset(laser={"max_range": 3.0}, features={"points": {"range_margin_m": margin}})
        return [s for s in features_at(config, Pose(-1.5, -0.5, 0.0)).observations if s.kind == Kind.END]

    assert len(ends(0.2)) == 1  # the stub's end, 2.5 m away
    assert ends(0.6) == []


def test_range_noise_alone_does_not_split_a_wall():
    ranges = np.array([1.0, 1.03, 1.0, 1.03, 1.0])
    for sigma, pieces in ((0.0, 5), (0.02, 1)):
        assert len(partition(ranges, 0.001, False, sigma, PartitionConfig())[1]) == pieces


def matched(config, point, cov=1e-2):
    """Whether an observation at `point` is matched with the known landmark at (2, 0), and whether it is a new one."""
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(config)
    known = [Observation(Kind.CORNER, np.array([2.0, 0.0]), np.eye(2) * cov)]
    estimator.update(associator.associate(known, estimator).observations)
    found = associator.associate([Observation(Kind.CORNER, np.array(point), np.eye(2) * cov)], estimator)
    return 0 in found.observations, 1 in found.observations


def test_only_landmarks_within_the_pre_gate_are_compared():
    assert matched(AssociationConfig(pre_gate_m=1.0), (2.4, 0.0)) == (True, False)
    assert matched(AssociationConfig(pre_gate_m=0.3), (2.4, 0.0))[0] is False


def test_a_new_landmark_keeps_its_distance_from_known_ones():
    assert matched(AssociationConfig(new_separation_m=0.3), (2.2, 0.0), 1e-4) == (False, False)
    assert matched(AssociationConfig(new_separation_m=0.1), (2.2, 0.0), 1e-4) == (False, True)


def test_of_two_landmarks_at_the_same_distance_in_sigmas_the_more_certain_one_is_matched():
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
    known = [Observation(Kind.CORNER, np.array([2.0, 0.0]), np.eye(2) * 1e-4),
             Observation(Kind.CORNER, np.array([2.0, 1.0]), np.eye(2) * 0.1)]  # fmt: skip
    estimator.update(associator.associate(known, estimator).observations)
    # 0.044 m from the first is 3.1 of its sigmas, 0.956 m from the second 3.0 of its own: the density decides.
    found = associator.associate([Observation(Kind.CORNER, np.array([2.0, 0.044]), np.eye(2) * 1e-4)], estimator)
    assert list(found.observations) == [0]


def test_simulated_bearing_noise_is_as_configured():
    def spread(sigma):
        config = merge(preset("noiseless"), {"world": {"laser": {"bearing_rad": sigma}}})
        world = World(ROOM, Pose(), 0.2, config, np.random.default_rng(0))
        scans = [t.scan.ranges.astype(float) for t in (world.step(Command()) for _ in range(500)) if t.scan]
        return np.std(scans, axis=0)[(np.abs(beam_bearings(config.laser) - 0.4) < 0.02)]

    assert np.all(spread(0.0) == 0.0)
    # On the wall x = 3 met at 0.4 rad a bearing error moves the range by r tan(0.4).
    assert spread(0.01).mean() == pytest.approx(0.01 * 3.0 / math.cos(0.4) * math.tan(0.4), rel=0.15)


def test_a_wheel_scale_error_scales_the_turn_too():
    config = merge(preset("noiseless"), {"world": {"wheel_scale_error": 0.1}})
    world = World(ROOM, Pose(), 0.2, config, np.random.default_rng(0))
    for _ in range(51):
        tick = world.step(Command(0.0, 0.8))
    assert tick.odometry.theta == pytest.approx(0.8) and tick.truth.theta == pytest.approx(0.88)


@pytest.mark.parametrize("passes", [True, False])
def test_a_beam_without_a_return_is_evidence_only_if_configured(passes):
    grid = Grid(preset(grid={"no_return_passes": passes}).grid, 0.2)
    scan = Scan.from_config(np.array([np.inf, np.inf]), preset(laser={"beams": 2, "fov": 0.1}).laser)
    grid.add(Pose(), scan, np.zeros((0, 2, 2)))
    assert grid.passes.any() == passes and grid.seen.any() == passes


def test_the_clock_of_a_keyframe_counts_its_processing_not_the_source(monkeypatch):
    config = preset("noiseless")
    world = World(ROOM, Pose(), 0.2, config, np.random.default_rng(0))

    now_s = [0.0]  # a clock that the source alone moves

    class Slow(Log):
        def step(self, command):
            now_s[0] += 1.0
            return super().step(command)

    ticks = [world.step(Command(0.0, 0.5)) for _ in range(60)]
    log = Slow([Tick(t.stamp_ns, t.odometry, t.scan, log_stamp_s=t.stamp_ns * 1e-9) for t in ticks])
    with monkeypatch.context() as patch:
        patch.setattr("time.perf_counter", lambda: now_s[0])
        metrics = measure(replay(log, config))
    assert metrics["stage_ms_mean.sense"] >= 1000.0 and metrics["scan_ms_max"] == 0.0
    again = replay(log, config)
    assert len(again.stamps_ns) == 12  # a log can be replayed more than once
