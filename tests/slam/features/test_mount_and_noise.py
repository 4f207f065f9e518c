"""What the stages of extraction give for general mounts, floors and sweeps, by hand and by finite differences."""

import dataclasses
import math

import numpy as np
import pytest
from scanned import box, look

from sixthsense.config import PartitionConfig, merge, preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.landmarks import Kind, Observation, initialize_landmark, line_point
from sixthsense.core.laser import Scan, Sweep
from sixthsense.slam.features import extract
from sixthsense.slam.features.deskew import add_sweep_noise
from sixthsense.slam.features.partition import partition

MOUNT = Pose(0.31, -0.17, 2.3)
WALLS = np.concatenate([box(0, 0, 6, 4), [[(3, 0), (3, 1.5)], [(3, 2.5), (3, 4)]]])


def extracted(mount, landmarks, floor_m=0.0, floor_rad=0.0):
    floors = {"landmark_floor_m": floor_m, "wall_floor_rad": floor_rad}
    config = merge(preset(features={"landmarks": landmarks}), {"assumed": floors})
    scan = look(Pose(1.3, 1.1, 0.4), WALLS, config.laser, 0.01, np.random.default_rng(3))
    scan = dataclasses.replace(scan, T_robot_laser=mount)
    return extract(scan, config.assumed, config.features)


@pytest.mark.parametrize("landmarks", ["corners", "both"])
def test_a_mount_moves_what_is_seen_with_its_covariance(landmarks):
    plain, mounted = extracted(Pose(), landmarks), extracted(MOUNT, landmarks)
    assert mounted.walls == pytest.approx((MOUNT @ plain.walls.reshape(-1, 2)).reshape(-1, 2, 2))
    kinds = [one.kind for one in plain.observations]
    assert kinds == [one.kind for one in mounted.observations] and len(set(kinds)) == 2
    for before, after in zip(plain.observations, mounted.observations, strict=True):
        mean, _, by_z = initialize_landmark(MOUNT, before)
        assert after.z == pytest.approx(mean) and after.cov == pytest.approx(by_z @ before.cov @ by_z.T)
        if after.is_wall:
            ends = [line_point(before.z, place) for place in before.extent]
            assert line_point(after.z, after.extent[0]) == pytest.approx(MOUNT @ ends[0])
            assert line_point(after.z, after.extent[1]) == pytest.approx(MOUNT @ ends[1])
            seen = np.abs(mounted.walls @ [math.cos(mean[0]), math.sin(mean[0])] - mean[1]).max(axis=1).argmin()
            along = mounted.walls[seen] @ [-math.sin(mean[0]), math.cos(mean[0])]
            assert sorted(after.extent) == pytest.approx(sorted(along), abs=0.01)


def test_floors_are_added_along_all_directions_and_about_the_middle_of_a_wall():
    for before, after in zip(*(extracted(MOUNT, "both", *floors).observations for floors in ((), (0.03, 0.02))),
                             strict=True):  # fmt: skip
        middle = sum(before.extent) / 2.0
        to_foot = np.array([[1.0, 0.0], [middle, 1.0]]) if before.is_wall else np.eye(2)
        added = to_foot @ np.diag([0.0004 if before.is_wall else 0.0009, 0.0009]) @ to_foot.T
        assert after.cov - before.cov == pytest.approx(added, abs=1e-12)


def test_the_noise_of_a_sweep_is_that_of_the_motion_since_each_landmark_was_seen():
    n, root = 90, np.array([[0.02, 0.0, 0.0], [0.01, 0.03, 0.0], [0.02, -0.01, 0.05]])
    bearings = np.linspace(-3.3, 2.9, n)
    lags = np.linspace(0.95, 0.05, n) ** 2
    scan = Scan(np.full(n, 2.0, np.float32), np.float32(-3.3), np.float32(0.07), 9.0, MOUNT,
                sweep=Sweep(bearings, True, root @ root.T, lags))  # fmt: skip
    cov = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
    observations = [Observation(Kind.CORNER, MOUNT @ [1.4 * math.cos(b), 1.4 * math.sin(b)], cov)
                    for b in (-3.2, -0.4, 2.7)]  # fmt: skip
    observations.append(Observation(Kind.WALL, np.array([0.8, -1.9]), cov, (0.3, 1.5)))
    x, y = MOUNT.inverse() @ line_point(observations[3].z, 0.9)
    seen_at = [-3.2, -0.4, 2.7, math.atan2(y, x)]
    for one, found, bearing in zip(observations, add_sweep_noise(observations, scan), seen_at, strict=True):
        moved = [[initialize_landmark(Pose(*step), one)[0] for step in (s, -s)] for s in 1e-6 * np.eye(3)]
        by_motion = np.array([ahead - behind for ahead, behind in moved]).T / 2e-6
        added = 4 * np.interp(bearing, bearings, lags) * by_motion @ root @ root.T @ by_motion.T
        assert found.cov - cov == pytest.approx(added, rel=1e-6)
    instant = dataclasses.replace(scan, sweep=None)
    assert add_sweep_noise(observations, instant) == tuple(observations)


@pytest.mark.parametrize("sigma", [0.0, 0.02])
@pytest.mark.parametrize("order", [1, -1])
def test_two_returns_are_of_one_wall_unless_it_would_be_met_flatter_than_allowed(sigma, order):
    config, spacing = PartitionConfig(method="adaptive"), 0.02
    near = np.array([1.7, 0.0])
    along = rotation(config.incidence_rad) @ [1.0, 0.0]  # a wall met at the least angle
    across = np.array([-math.sin(spacing), math.cos(spacing)])
    reach = -near @ across / (along @ across)  # to the next beam
    for longer, pieces in ((0.99, 1), (1.01, 2)):
        gap = longer * (reach + 3.0 * sigma)
        # The range of the second return, at that distance from the first one.
        ranges = np.array([1.7, 1.7 * math.cos(spacing) + math.sqrt(gap**2 - (1.7 * math.sin(spacing)) ** 2)])
        _, found, _ = partition(ranges[::order], np.full(2, spacing), spacing, False, 1.0, config.incidence_rad, sigma)
        assert len(found) == pieces
