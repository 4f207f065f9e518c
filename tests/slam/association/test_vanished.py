"""Which landmarks of a prior map are taken to be gone, by what beams pass them."""

import math

import numpy as np
import pytest

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.association.records import Record
from sixthsense.slam.association.vanished import Vanished
from sixthsense.slam.estimators import Estimate

LASER = LaserConfig()
ROOM = np.array([[[-4, -3], [4, -3]], [[4, -3], [4, 3]], [[4, 3], [-4, 3]], [[-4, 3], [-4, -3]]], dtype=np.float64)
DIVIDER = np.array([[[1.0, -1.0], [1.0, 1.0]]])
WALL, END = 3, 7
SEEN = Observation(Kind.WALL, np.array([math.pi, -1.0]), np.eye(2) * 1e-4, (-1.0, 1.0))
AT = Pose(-1.0, 0.2, 0.1)


def look(pose, *segments, noise=0.0):
    walls = np.concatenate([ROOM, *segments])
    ranges = cast_rays(pose, beam_bearings(LASER), walls, LASER.max_range)
    ranges = ranges + noise * np.random.default_rng(0).standard_normal(len(ranges))
    return Scan.from_config(ranges, LASER)


def records():
    wall = Record(Kind.WALL, 9, 0, 0, extent=DIVIDER[0])
    return {WALL: wall, END: Record(Kind.END, 9, 0, 0, sigma_m=0.01)}


def estimate(pose, sigma=0.005):
    landmarks = np.array([[math.pi, -1.0], [1.0, 1.0]])
    cov = np.diag([sigma, sigma, sigma]) ** 2
    return Estimate(pose, cov, np.array([WALL, END]), landmarks, np.array([True, False]))


def gone_after(scans, observations=(), sigma=0.005, no_return_passes=True, pose=AT):
    vanished, found = Vanished([WALL, END], no_return_passes), []
    for k, scan in enumerate(scans):
        seen = {WALL: SEEN} if k in observations else {}
        found += vanished.gone(scan, estimate(pose, sigma), seen, records())
    return sorted(found)


def gone_on_the_way(poses, *segments):
    vanished, found = Vanished([WALL, END], True), []
    for pose in poses:
        found += vanished.gone(look(pose, *segments), estimate(pose), {}, records())
    return sorted(found)


@pytest.mark.parametrize("pose", [AT, Pose(3.0, 0.3, 2.0), Pose(0.5, 2.5, -1.0)])
def test_a_wall_is_gone_after_six_scans_through_it_from_any_side(pose):
    assert gone_after([look(pose)] * 5, pose=pose) == []
    assert gone_after([look(pose)] * 6, pose=pose) == [WALL]


def test_an_end_is_gone_after_six_scans_through_it_from_two_directions():
    assert END not in gone_on_the_way([AT] * 40)
    assert END in gone_on_the_way([AT] * 5 + [Pose(-1.0, 2.0, 0.0)])
    assert END not in gone_on_the_way([AT] * 4 + [Pose(-1.0, 2.0, 0.0)])


def test_an_end_is_not_gone_on_a_drive_along_its_wall():
    poses = [Pose(1.05, 2.8 - 0.1 * k, -1.5) for k in range(16)]
    assert gone_on_the_way(poses, DIVIDER) == []


@pytest.mark.parametrize("pose", [AT, Pose(3.0, 0.3, 2.0), Pose(0.5, 2.5, -1.0), Pose(1.05, 2.0, 0.0)])
def test_a_wall_that_is_there_is_never_gone(pose):
    assert gone_after([look(pose, DIVIDER, noise=0.02)] * 40, pose=pose) == []


def test_a_hidden_wall_is_not_gone():
    screen = np.array([[[0.0, -2.0], [0.0, 2.0]]])
    assert gone_after([look(AT, screen)] * 40) == []


def test_a_wall_beside_an_open_door_is_not_gone():
    door = np.array([[[1.0, -1.0], [1.0, -0.2]], [[1.0, 0.5], [1.0, 1.0]]])
    assert gone_after([look(AT, door)] * 40) == []


def test_one_observation_outweighs_four_scans():
    assert gone_after([look(AT)] * 10, observations=(4,)) == []  # 4 through it, 0 after the observation, then 5
    assert gone_after([look(AT)] * 11, observations=(4,)) == [WALL]


def test_an_uncertain_pose_says_nothing():
    assert gone_after([look(AT)] * 40, sigma=0.5) == []


def test_beams_without_a_return_tell_only_where_they_pass():
    far = Scan.from_config(np.full(LASER.beams, np.inf), LASER)
    assert gone_after([far] * 6) == [WALL]
    assert gone_after([far] * 40, no_return_passes=False) == []


def test_landmarks_of_this_run_are_not_watched():
    vanished = Vanished([], True)
    assert all(vanished.gone(look(AT), estimate(AT), {}, records()) == [] for _ in range(20))


def test_a_landmark_that_was_culled_is_no_longer_watched():
    vanished = Vanished([WALL, END], True)
    kept = {END: records()[END]}
    rest = Estimate(AT, 1e-6 * np.eye(3), np.array([END]), np.array([[1.0, 1.0]]), np.array([False]))
    assert all(vanished.gone(look(AT), rest, {}, kept) == [] for _ in range(20))
