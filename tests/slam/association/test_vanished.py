"""Which landmarks of a prior map are taken to be gone, by what the map of this run shows."""

import math

import numpy as np
import pytest
from scanned import box, look

from sixthsense.config import AssociationConfig, GridConfig, LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import LandmarkPrior, make_estimator
from sixthsense.slam.mapping.mapper import Mapper

LASER = LaserConfig()
ROOM = box(-4, -3, 8, 6)
DIVIDER = np.array([[[1.0, -1.0], [1.0, 1.0]]])
WALL, END = 3, 7
AT = Pose(-1.0, 0.2, 0.1)
BOTH_SIDES = [AT, Pose(3.0, 0.3, 2.0)]


def seen(pose, *segments, noise=0.0):
    return look(pose, np.concatenate([ROOM, *segments]), LASER, noise)


def mapped(poses, scans, no_return_passes=True):
    """The map of scans at poses, which begins with the divider."""
    before, mapper = (Mapper(GridConfig(no_return_passes=no_return_passes), 0.2) for _ in range(2))
    before.add(0, lambda: AT.array()[None], seen(AT, DIVIDER))
    mapper.start_from(before.draw().submap())
    for k, scan in enumerate(scans):
        rows = np.array([pose.array() for pose in poses[: k + 1]])
        mapper.add(k, lambda rows=rows: rows, scan)
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
    assert gone(mapped([pose] * 20, [seen(pose)] * 20)) == [WALL, END]


SCREEN = np.array([[[0.0, -2.0], [0.0, 2.0]]])
DOOR = np.array([[[1.0, -1.0], [1.0, -0.2]], [[1.0, 0.5], [1.0, 1.0]]])
IN_LINE, ALONG = Pose(1.05, 2.0, 0.0), [Pose(1.05, 2.8 - 0.1 * k, -1.5) for k in range(16)]


def drive(poses, *segments, noise=0.0):
    """The map after scans at some poses, in which there are the `segments`."""
    return mapped(poses, [seen(pose, *segments, noise=noise) for pose in poses])


def blank(**options):
    """The map after scans without a return."""
    return mapped([AT] * 20, [Scan.from_config(np.full(LASER.beams, np.inf), LASER)] * 20, **options)


SHOWN = {
    "one scan through it": (lambda: drive([AT]), []),
    "a wall that is there": (lambda: drive([AT] * 40, DIVIDER, noise=0.02), []),
    "a wall that is there, from behind": (lambda: drive([BOTH_SIDES[1]] * 40, DIVIDER, noise=0.02), []),
    "a wall that is there, askew": (lambda: drive([Pose(0.5, 2.5, -1.0)] * 40, DIVIDER, noise=0.02), []),
    # Beams that graze the end free its cells, as the map has it.
    "a wall in line with the robot": (lambda: drive([IN_LINE] * 40, DIVIDER, noise=0.02), [END]),
    "a wall on a drive along it": (lambda: drive(ALONG, DIVIDER), []),
    "a hidden wall": (lambda: drive([AT] * 40, SCREEN), []),
    "a wall beside an open door": (lambda: drive(BOTH_SIDES * 20, DOOR), []),
    "beams without a return": (blank, [WALL, END]),
    "beams without a return that pass nothing": (lambda: blank(no_return_passes=False), []),
}


@pytest.mark.parametrize("case", SHOWN)
def test_what_is_gone_by_what_the_map_shows(case):
    shown, expected = SHOWN[case]
    assert gone(shown()) == expected


@pytest.mark.parametrize("options", [{"seen_at": 10}, {"sigma": 0.5}, {"prior": False}, {"keyframes": 24}], ids=str)
def test_nothing_is_gone_that_was_just_seen_from_an_uncertain_pose_of_this_run_or_within_a_period(options):
    assert gone(drive([AT] * 20), **options) == []
