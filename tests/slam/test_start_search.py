"""Where in a prior map a run begins, by its first scan."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scanned import look, map_of, outline

from sixthsense.config import Config, LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.slam.relocalization import located

LASER, CONFIG = LaserConfig(), Config()
ROOM = outline((0, 0), (5, 0), (5, 4), (3, 4), (3, 3), (0, 3))
CORRIDOR = np.array([[[-30.0, -1.0], [30.0, -1.0]], [[-30.0, 1.0], [30.0, 1.0]]])
TRUE = Pose(1.2, 1.1, 0.4)


def seen(walls, pose, seed=0):
    return look(pose, walls, LASER, 0.01, seed)


ROOM_MAP = map_of(ROOM, [Pose(1.0, 1.0, 0.0), Pose(4.0, 3.0, 1.0), Pose(3.5, 1.0, 2.0)], LASER)


@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.8])
@pytest.mark.parametrize("seed", range(2))
def test_a_rough_pose_is_found_to_a_few_centimetres(sigma, seed):
    sigmas = np.array([sigma, sigma, 0.5 * sigma])
    error = np.clip(np.random.default_rng(seed).standard_normal(3), -2.0, 2.0) * sigmas
    rough = Pose.from_array(TRUE.array() + error)
    found = located(seen(ROOM, TRUE), ROOM_MAP, rough, np.diag(sigmas**2), CONFIG)
    assert math.hypot(found.x - TRUE.x, found.y - TRUE.y) < 0.04
    assert abs(wrap_angle(found.theta - TRUE.theta)) < 0.015


def test_a_wall_that_has_moved_does_not_shift_the_pose():
    changed = np.concatenate([ROOM, [[[2.2, 0.5], [2.2, 1.6]]]])
    rough = Pose(1.35, 1.0, 0.5)
    found = located(seen(changed, TRUE), ROOM_MAP, rough, np.diag([0.2, 0.2, 0.1]) ** 2, CONFIG)
    assert math.hypot(found.x - TRUE.x, found.y - TRUE.y) < 0.05


def test_along_a_corridor_the_pose_stays_where_it_was_said_to_be():
    """Nothing tells the place along it, so that the given one is as good as any."""
    corridor = map_of(CORRIDOR, [Pose(float(x), 0.0, 0.0) for x in range(-12, 13)], LASER)
    true, rough = Pose(0.15, 0.1, 0.05), Pose(0.0, 0.0, 0.0)
    found = located(seen(CORRIDOR, true), corridor, rough, np.diag([0.08, 0.08, 0.04]) ** 2, CONFIG)
    assert abs(found.x - rough.x) < 0.06
    assert abs(found.y - true.y) < 0.03 and abs(found.theta - true.theta) < 0.015


@pytest.mark.parametrize("cov", [np.zeros((3, 3)), np.diag([0.3, 0.3, 0.2]) ** 2])
def test_a_scan_of_another_room_is_refused(cov):
    other = 2.2 * ROOM - np.array([3.0, 2.0])
    with pytest.raises(InputError, match=r"^prior_map: found earlier, of which the first scan shows"):
        located(seen(other, TRUE), ROOM_MAP, TRUE, cov, CONFIG)


def test_a_scan_without_a_return_says_nothing_against_the_given_pose():
    scan = seen(ROOM, TRUE)
    blank = replace(scan, ranges=np.full_like(scan.ranges, scan.max_range))
    assert located(blank, ROOM_MAP, TRUE, np.diag([0.3, 0.3, 0.2]) ** 2, CONFIG) is TRUE
