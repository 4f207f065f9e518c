"""Which landmarks of a prior map are taken to be gone, by what the map of this run shows."""

import math

import numpy as np
import pytest

from sixthsense.config import AssociationConfig, GridConfig, LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import LandmarkPrior, make_estimator
from sixthsense.slam.mapping.mapper import Mapper

LASER = LaserConfig()
ROOM = np.array([[[-4, -3], [4, -3]], [[4, -3], [4, 3]], [[4, 3], [-4, 3]], [[-4, 3], [-4, -3]]], dtype=np.float64)
DIVIDER = np.array([[[1.0, -1.0], [1.0, 1.0]]])
NOTHING = np.zeros((0, 2, 2))
WALL, END = 3, 7
AT = Pose(-1.0, 0.2, 0.1)
BOTH_SIDES = [AT, Pose(3.0, 0.3, 2.0)]


def look(pose, *segments, noise=0.0):
    walls = np.concatenate([ROOM, *segments])
    ranges = cast_rays(pose, beam_bearings(LASER), walls, LASER.max_range)
    ranges = ranges + noise * np.random.default_rng(0).standard_normal(len(ranges))
    return Scan.from_config(ranges, LASER)


def mapped(poses, scans, no_return_passes=True):
    """The map of scans at poses, which begins with the divider."""
    before, mapper = (Mapper(GridConfig(no_return_passes=no_return_passes), 0.2) for _ in range(2))
    before.add(lambda: AT.array()[None], look(AT, DIVIDER), NOTHING)
    mapper.start_from(before.grid.submap())
    for k, scan in enumerate(scans):
        rows = np.array([pose.array() for pose in poses[: k + 1]])
        mapper.add(lambda rows=rows: rows, scan, NOTHING)
    return mapper


def gone(mapper, sigma=0.005, seen_at=0, prior=True, keyframes=25):
    """The landmarks that are gone, of a wall and its end that were last seen in keyframe `seen_at`."""
    records = {WALL: Record(Kind.WALL, 9, 0, seen_at, extent=DIVIDER[0]), END: Record(Kind.END, 9, 0, seen_at)}
    associator = Associator(AssociationConfig(), records if prior else None, mapper.are_free)
    associator.records.update(records)
    estimator = make_estimator("ekf", AT, np.diag([sigma, sigma, sigma]) ** 2)
    landmarks = np.array([[math.pi, -1.0], [1.0, 1.0]])
    walls = np.array([True, False])
    extents = np.stack([DIVIDER[0], np.zeros((2, 2))])
    estimator.start_from(LandmarkPrior(np.array([WALL, END]), landmarks, walls, 1e-4 * np.eye(4), extents))
    for _ in range(keyframes):
        associator.associate([], estimator)
    return sorted(associator.forgotten(estimator, estimator.estimate()))


@pytest.mark.parametrize("pose", [AT, Pose(3.0, 0.3, 2.0), Pose(0.5, 2.5, -1.0)])
def test_a_wall_and_its_end_are_gone_where_scans_go_through_them_from_any_side(pose):
    assert gone(mapped([pose] * 20, [look(pose)] * 20)) == [WALL, END]


def test_one_scan_is_not_enough():
    assert gone(mapped([AT], [look(AT)])) == []


@pytest.mark.parametrize("pose", [AT, Pose(3.0, 0.3, 2.0), Pose(0.5, 2.5, -1.0)])
def test_what_is_there_is_never_gone(pose):
    assert gone(mapped([pose] * 40, [look(pose, DIVIDER, noise=0.02)] * 40)) == []


def test_a_wall_that_is_there_is_not_gone_for_a_robot_that_stands_in_line_with_it():
    """Its end is: beams that graze it free its cells, as the map has it."""
    pose = Pose(1.05, 2.0, 0.0)
    assert gone(mapped([pose] * 40, [look(pose, DIVIDER, noise=0.02)] * 40)) == [END]


def test_neither_wall_nor_end_is_gone_on_a_drive_along_the_wall():
    poses = [Pose(1.05, 2.8 - 0.1 * k, -1.5) for k in range(16)]
    assert gone(mapped(poses, [look(pose, DIVIDER) for pose in poses])) == []


def test_a_hidden_wall_is_not_gone():
    screen = np.array([[[0.0, -2.0], [0.0, 2.0]]])
    assert gone(mapped([AT] * 40, [look(AT, screen)] * 40)) == []


def test_a_wall_beside_an_open_door_is_not_gone():
    door = np.array([[[1.0, -1.0], [1.0, -0.2]], [[1.0, 0.5], [1.0, 1.0]]])
    poses = BOTH_SIDES * 20
    assert gone(mapped(poses, [look(pose, door) for pose in poses])) == []


def test_a_landmark_that_was_seen_in_this_period_is_not_gone():
    assert gone(mapped([AT] * 20, [look(AT)] * 20), seen_at=10) == []


def test_an_uncertain_pose_says_nothing():
    assert gone(mapped([AT] * 20, [look(AT)] * 20), sigma=0.5) == []


def test_beams_without_a_return_tell_only_where_they_pass():
    far = [Scan.from_config(np.full(LASER.beams, np.inf), LASER)] * 20
    assert WALL in gone(mapped([AT] * 20, far))
    assert gone(mapped([AT] * 20, far, no_return_passes=False)) == []


def test_landmarks_of_this_run_stay():
    assert gone(mapped([AT] * 20, [look(AT)] * 20), prior=False) == []


def test_landmarks_are_looked_for_once_a_period():
    assert gone(mapped([AT] * 20, [look(AT)] * 20), keyframes=24) == []
