"""Where in a prior map a robot is that does not know where it began."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scanned import box, look, map_of, outline

from sixthsense.config import Config, GridConfig, LaserConfig, ScansConfig, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.source import Command, Tick
from sixthsense.logs.log import Playback
from sixthsense.loop import run as loop
from sixthsense.record.folder import RunFolder
from sixthsense.record.store import read_prior_map
from sixthsense.simulation.scene import load_scene
from sixthsense.slam.prior_map import PriorStart
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
    assert search(along((13, 2), (14, 3), (11.5, 3), (12, 1), (14.5, 2.5))) is None


@pytest.mark.parametrize("room", [pytest.param(0.0, marks=pytest.mark.slow), 10.0])
def test_once_the_corridor_tells_the_rooms_apart_the_place_is_found(room):
    way = along((room + 2, 2), (room + 4.5, 2), (room + 4.5, 5), (18.5, 5), (18.5, 6.2), (18.5, 5), (16, 5))
    driven_m, error = search(way)
    if room == 0.0:
        assert search(way, min_score=1.0) is None  # no place explains every return
    assert driven_m > 4.0
    assert math.hypot(error.x, error.y) < 0.1 and abs(wrap_angle(error.theta)) < 0.03


def test_in_another_building_nothing_is_found():
    other = np.concatenate([outline((0, 0), (9, -2), (12, 6), (3, 9)), box(4, 3, 1.5, 1.5)])
    assert search(along((1.5, 1.5), (6, 1), (9, 3), (6.5, 6), (3.5, 6), (2, 2)), other) is None


class Numbers:
    """A source that counts to five."""

    def __init__(self):
        self.count = 0

    def step(self, command):
        self.count += 1
        return Tick(self.count, Pose()) if self.count <= 5 else None


def test_the_ticks_so_far_come_once_more_and_then_the_others():
    numbers, command = Numbers(), Command()
    source = Playback([numbers.step(command) for _ in range(3)], numbers)
    assert [source.step(command).stamp_ns for _ in range(5)] == [1, 2, 3, 4, 5]
    assert source.step(command) is None


LOPSIDED = outline((0, 0), (5, 0), (5, 4), (3, 4), (3, 3), (0, 3))


def scene_of(walls, start):
    tour = ((4.2, 0.8), (4.2, 3.2), (2.6, 2.4), (0.8, 2.2), (0.8, 0.8))
    base = load_scene("rectangle")
    return dataclasses.replace(base, walls=walls, start=start, tour=tour, region=(0.0, 0.0, 5.0, 4.0))


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The map of a tour of the lopsided room."""
    from sixthsense.evaluation.measure import measure

    config = preset(scene="rectangle", task="tour", max_time=20.0, seed=1)
    folder = RunFolder(tmp_path_factory.mktemp("runs") / "first", config)
    trace = loop.run(config, folder.record, scene_of(LOPSIDED, Pose(0.8, 0.8, 0.3)))
    folder.write(trace, measure(trace))
    folder.finish()
    return read_prior_map(folder.out)


def test_a_lost_robot_finds_its_place_and_drives_its_task_and_so_does_the_replay_of_its_log(first):
    config = preset(scene="rectangle", task="tour", max_time=25.0, seed=2)
    trace = loop.run(config, scene=scene_of(LOPSIDED, Pose(3.5, 2.0, -2.0)), prior=PriorStart(first, is_lost=True))
    errors = np.array([p[:2] for p in trace.estimates]) - np.array([p[:2] for p in trace.truths])
    assert trace.outcome == "tour ended"
    assert np.hypot(*errors.T).max() < 0.1
    assert trace.prior_map == {"name": "first", "digest": first.digest, "lost": True}


def test_a_lost_robot_in_another_building_ends_in_one_line(first):
    other = np.concatenate([outline((-3, -3), (9, -3), (9, 7.5), (-3, 7.5)), box(2, 2, 2, 1)])
    scene = dataclasses.replace(scene_of(other, Pose()), region=(-3.0, -3.0, 9.0, 7.5), tour=((4.2, 0.8), (0.8, 0.8)))
    config = preset(scene="rectangle", task="tour", max_time=10.0, seed=2)
    with pytest.raises(InputError, match=r"^lost: found no place of first that alone fits what was seen on \d+ m"):
        loop.run(config, scene=scene, prior=PriorStart(first, is_lost=True))
