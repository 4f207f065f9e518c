"""Places that look alike: what scans can tell of them, and what is done until they can."""

import math

import numpy as np
import pytest
from rooms import HALF, ROUND, scan_at, stored
from test_front_end import drive, old_links, ticks

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import between
from sixthsense.slam.scans.graph import ScanGraph, overlapping
from sixthsense.slam.scans.known_places import KnownPlaces
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.scans.place_search import Candidate, Evidence, Votes, evidence_of
from sixthsense.slam.slam import Slam

PITCH = 3.0


def corridor(length=24.0, width=2.2, deep=0.2):
    """A corridor along x with equal doors on both sides, and closed ends."""
    doors = np.arange(1.0, length - 1.5, PITCH)
    side = [(0.0, 0.0)]
    for x in doors:
        side += [(x, 0.0), (x, -deep), (x + 1.0, -deep), (x + 1.0, 0.0)]
    side = np.array([*side, (length, 0.0)])
    outline = np.concatenate([side, (side * (1.0, -1.0) + (0.0, width))[::-1]])
    return np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)


def equal_rooms(count=4, pitch=4.4):
    """Rooms on one side of a corridor along x, each with a door and a table."""
    inner = [[[0, 0], [1.7, 0]], [[2.7, 0], [pitch, 0]], [[0, 0], [0, 4]], [[0, 4], [pitch, 4]]]
    table = np.array([[1.2, 1.5], [2.0, 1.5], [2.0, 2.2], [1.2, 2.2]])
    room = np.concatenate([inner, np.stack([table, np.roll(table, -1, axis=0)], axis=1)])
    long = count * pitch
    ends = [[[0, 0], [0, -2.2]], [[0, -2.2], [long, -2.2]], [[long, -2.2], [long, 4]]]
    return np.concatenate([ends, *(room + np.array([k * pitch, 0.0]) for k in range(count))])


def graph_of(poses, walls, laser):
    """A graph whose keyframes are scans from these poses."""
    rng = np.random.default_rng(0)
    graph = ScanGraph(stored(*(scan_at(pose, walls, laser, rng=rng) for pose in poses)), None, 0.01)
    for k, pose in enumerate(poses):
        graph.add(pose.array())
        if k:
            graph.moved(float(np.hypot(*(pose.position - poses[k - 1].position))), 1e-4, 1e-6)
    return graph


def evidence(graph, old, poses, keys):
    """Of some poses of the newest of the scans `keys`, where the scans before `old` are known."""
    return evidence_of(graph, keys, [Candidate(pose, 1.0, np.arange(old)) for pose in poses])


@pytest.fixture(scope="module")
def twice():
    """A drive along the middle of the corridor, and one beside it; neither sees an end."""
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, 0.05) for x in np.arange(10.0, 13.0, 0.4)]
    return graph_of([*old, *new], corridor(), LaserConfig(beams=181, fov=math.pi, max_range=6.0)), len(old)


def evidence_at(graph, old, shift):
    """What the newest scans say of a pose that is off along the corridor by `shift`."""
    pose = graph.poses[-1] + np.array([shift, 0.0, 0.0])
    return evidence(graph, old, [pose], np.arange(graph.count - 1, old - 1, -2))[0]


def test_the_next_door_explains_a_scan_as_well_as_the_true_one(twice):
    true, next_door = (evidence_at(*twice, shift) for shift in (0.0, -PITCH))
    assert true.weight > 0.0 and next_door.weight > 0.0
    assert not true.is_clearly_better(next_door) and not next_door.is_clearly_better(true)


@pytest.mark.parametrize("shift", [-2.2, -1.5, -0.8, 0.8, 1.5])
def test_a_place_between_two_doors_explains_clearly_less(twice, shift):
    true, between_doors = evidence_at(*twice, 0.0), evidence_at(*twice, shift)
    assert true.is_clearly_better(between_doors) and not between_doors.is_clearly_better(true)


def test_an_end_that_was_seen_tells_the_doors_apart():
    old = [Pose(x, 1.1, 0.0) for x in np.arange(10.0, 20.0, 0.4)]
    new = [Pose(x, 1.15, 0.0) for x in np.arange(16.0, 21.0, 0.4)]
    graph = graph_of([*old, *new], corridor(), HALF)
    true, next_door = (evidence_at(graph, len(old), shift) for shift in (0.0, -PITCH))
    assert true.is_clearly_better(next_door)


@pytest.mark.parametrize("laser", [ROUND, LaserConfig(beams=181, fov=math.pi, max_range=6.0)])
def test_scans_of_the_way_back_tell_about_a_place(laser):
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, math.pi) for x in np.arange(15.0, 10.0, -0.4)]
    graph = graph_of([*old, *new], corridor(), laser)
    keys = np.arange(graph.count - 1, len(old) - 1, -2)
    (found,) = evidence(graph, len(old), graph.poses[-1:], keys)
    assert np.isfinite(found.shares).sum() >= 5 and found.weight > 1.0
    assert np.abs(between(graph.poses[-1], found.pose))[1:].max() < 0.02
    links = Alignments.joined(found.links)
    off = links.poses - between(graph.poses[links.targets], graph.poses[links.sources])
    assert len(np.unique(links.sources)) >= 3 and np.abs(off[:, 1]).max() < 0.05


def test_views_overlap_where_scans_look_at_one_place():
    ahead, away = Pose(8.0, 1.1, 0.0), Pose(15.0, 1.1, 0.0)
    graph = graph_of([ahead, away, Pose(13.0, 1.1, math.pi)], corridor(), HALF)
    assert overlapping(graph, 2, graph.poses[2], np.arange(2)).tolist() == [0]
    behind = graph_of([ahead, Pose(8.5, 1.2, math.pi)], corridor(), HALF)
    assert not len(overlapping(behind, 1, behind.poses[1], np.arange(1)))
    around = graph_of([ahead, Pose(8.5, 1.2, math.pi), Pose(8.8, 1.2, 0.1)], corridor(), ROUND)
    assert overlapping(around, 2, around.poses[2], np.arange(2)).tolist() == [0, 1]


def test_places_are_compared_on_scans_that_tell_about_both():
    nothing = math.nan
    one = Evidence(np.zeros(3), np.array([0.9, 0.9, 0.9, nothing, nothing, nothing, nothing]), ())
    other = Evidence(np.zeros(3), np.array([0.85, 0.85, 0.85, 0.9, 0.9, nothing, nothing]), ())
    assert not one.is_clearly_better(other) and not other.is_clearly_better(one)
    poor = Evidence(np.zeros(3), np.array([0.75, 0.75, 0.7, nothing, nothing, nothing, nothing]), ())
    assert one.is_clearly_better(poor)
    unknown = Evidence(np.zeros(3), np.array([nothing, nothing, nothing, nothing, nothing, 0.9, 0.9]), ())
    assert not one.is_clearly_better(unknown)


def test_in_a_corridor_of_equal_doors_no_wrong_door_is_taken_and_the_scans_are_linked_once_it_is_clear():
    walls, laser = corridor(24.0), LaserConfig(beams=181, fov=math.pi, max_range=12.0)
    poses = drive(Pose(1.5, 1.1, 0.0), [(22.5, 1.1), (1.5, 1.15), (22.5, 1.05)], step=0.15)
    slam, truths = Slam(preset("log"), poses[0]), []
    with slam:
        for pose, tick in zip(poses, ticks(poses, walls, scale=1.02, drift=0.009, laser=laser), strict=True):
            if slam.take(tick).keyframe is not None:
                truths.append(pose.array())
    links, truths = old_links(slam), np.array(truths)
    wrong = [np.hypot(*(between(*truths[a["ends"]]) - a["pose"])[:2]) for a in links]
    assert max(wrong) < 0.3
    third = [k for k, truth in enumerate(truths) if k > 0.7 * len(truths) and truth[0] > 3.0]
    linked = links["ends"][:, 1].tolist()
    near = [min(abs(k - j) for j in linked) <= 6 for k in third]
    assert np.mean(near) > 0.95


def test_a_room_that_was_not_seen_before_is_not_taken_for_one_of_those_alike():
    way = [(4.4 * k + 2.2, y) for k in (0, 2, 1, 3) for y in (-1.1, 1.0, -1.1)]
    poses, laser = drive(Pose(0.8, -1.1), way, step=0.15, turn=0.15), ROUND.replaced(max_range=3.5)
    slam, truths = Slam(preset("log"), poses[0]), []
    with slam:
        for pose, tick in zip(poses, ticks(poses, equal_rooms(), scale=0.97, drift=0.01, laser=laser), strict=True):
            if slam.take(tick).keyframe is not None:
                truths.append(pose.array())
    links, truths = old_links(slam), np.array(truths)
    assert len(links) > 50
    assert max(np.hypot(*(between(*truths[a["ends"]]) - a["pose"])[:2]) for a in links) < 0.5


def test_a_place_is_believed_once_votes_some_metres_apart_agree_that_are_more_than_half():
    graph = graph_of([Pose(0.6 * k, 1.1, 0.0) for k in range(12)], corridor(), HALF)
    keys, votes = np.array([7, 8, 8]), Votes(graph)
    pairs = Alignments(keys - 7, keys, *(np.zeros((3, *shape)) for shape in ((3,), (3, 3), (3,), (2, 4))))
    there, elsewhere = (np.array([5.0, y, 0.3]) for y in (4.0, 9.0))

    def vote(key, pose, links=pairs):
        moved = Pose(*pose) @ Pose(0.6 * key, 0.0, 0.0)
        return len(votes.agreeing(key, Evidence(moved.array(), np.ones(2), (links,))))

    assert vote(7, there, pairs.rows(np.array([1, 2]))) == 0  # of one scan alone
    assert [vote(7, there), vote(8, there), vote(9, elsewhere), vote(10, there)] == [0, 0, 0, 3]
    assert vote(11, there) == 0  # those of before have been counted


def test_a_place_has_what_was_seen_after_it_was_looked_into_first():
    near = LaserConfig(beams=181, fov=math.pi, max_range=4.0)
    graph = graph_of([Pose(x, 1.1, 0.0) for x in np.arange(1.0, 18.0, 0.4)], corridor(), near)
    places, fresh, every = KnownPlaces(graph), KnownPlaces(graph), np.arange(graph.count)
    places.seek(every[:16], every[:16])
    before = places.submap(0, 12.0)
    for each in (places, fresh):
        each.seek(every, every)
    now, expected = places.submap(0, 12.0), fresh.submap(0, 12.0)
    assert np.array_equal(now.values, expected.values) and now.values.sum() > 1.2 * before.values.sum()
