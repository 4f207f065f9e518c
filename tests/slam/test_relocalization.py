"""Where in a prior map a robot is that does not know where it began."""

import itertools
import math

import numpy as np
import pytest
from scanned import box, look, map_of, outline

from sixthsense.config import Config, GridConfig, LaserConfig, ScansConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.slam.relocalization import Relocalizer

LASER, GRID = LaserConfig(max_range=6.0), GridConfig()


# Two equal rooms with doors to a corridor along y = 4 to 6, which ends in a recess on its right.
ROOMS = np.concatenate(
    [
        np.array(
            [
                [[0, 0], [20, 0]], [[0, 0], [0, 6]], [[10, 0], [10, 4]], [[0, 6], [18, 6]], [[18, 6], [18, 7]],
                [[18, 7], [20, 7]], [[20, 7], [20, 0]],
                [[0, 4], [4, 4]], [[5, 4], [14, 4]], [[15, 4], [20, 4]],
            ],
            dtype=float,
        ),
        box(7, 1, 1.0, 0.6),
        box(17, 1, 1.0, 0.6),
    ]
)  # fmt: skip


def seen(walls, pose, seed=0):
    return look(pose, walls, LASER, 0.01, seed)


def along(*points, step_m=0.2):
    """Poses from point to point, looking ahead."""
    poses = []
    for a, b in itertools.pairwise(points):
        there = np.subtract(b, a)
        for share in np.arange(0.0, 1.0, step_m / np.hypot(*there)):
            poses.append(Pose(*(np.asarray(a) + share * there), math.atan2(there[1], there[0])))
    return poses


WAY = along((1, 2), (4.5, 2), (4.5, 5), (14.5, 5), (14.5, 2), (12, 2), (14.5, 2), (14.5, 5), (19, 5), (19, 6.4))
MAP = map_of(ROOMS, WAY, LASER)


def search(poses, walls=ROOMS, prior=MAP, own=None, min_score=0.62):
    """Metres driven, and the error of its pose, once a robot that drives along the poses is certain; None if never."""
    own = own or Pose(3.0, -2.0, 0.7)
    relocalizer = Relocalizer(prior.scans, Config(grid=GRID, scans=ScansConfig(min_score=min_score)))
    for k, pose in enumerate(poses):
        found = relocalizer.take(seen(walls, pose, k), own @ poses[0].inverse() @ pose)
        if found is not None:
            return relocalizer.driven_m, pose.inverse() @ found @ own @ poses[0].inverse() @ pose
    return None


def test_in_one_of_two_equal_rooms_nothing_is_certain():
    assert search(along((13, 2), (14, 3), (11.5, 3), (12, 1), (14.5, 2.5), (13, 2), (11.5, 3))) is None


@pytest.mark.parametrize("room", [0.0, 10.0])
def test_once_the_corridor_tells_the_rooms_apart_the_place_is_found(room):
    way = along((room + 2, 2), (room + 4.5, 2), (room + 4.5, 5), (18.5, 5), (18.5, 6.2), (18.5, 5), (16, 5))
    driven_m, error = search(way)
    assert search(way, min_score=1.0) is None  # no place explains every return
    assert driven_m > 4.0
    assert math.hypot(error.x, error.y) < 0.1 and abs(wrap_angle(error.theta)) < 0.03


def test_in_another_building_nothing_is_found():
    other = np.concatenate([outline((0, 0), (9, -2), (12, 6), (3, 9)), box(4, 3, 1.5, 1.5)])
    assert search(along((1.5, 1.5), (6, 1), (9, 3), (6.5, 6), (3.5, 6), (2, 2)), other) is None
