"""Places that look alike: what scans can tell of them, and what is done until they can."""

import math

import numpy as np
import pytest
from rooms import HALF, ROUND, scan_at, stored
from test_front_end import drive, ticks

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.se2 import between
from sixthsense.slam.scans import place_search
from sixthsense.slam.scans.graph import ScanGraph
from sixthsense.slam.scans.links import align_pairs
from sixthsense.slam.scans.loop_closures import OldPass
from sixthsense.slam.scans.place_search import Evidence, Hypothesis, evidence_of, followed_back, verified
from sixthsense.slam.scans.returns import bearings_at
from sixthsense.slam.scans.visibility import explained
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


def graph_of(poses, walls, laser):
    """A graph whose keyframes are scans from these poses."""
    rng = np.random.default_rng(0)
    graph = ScanGraph(stored(*(scan_at(pose, walls, laser, rng=rng) for pose in poses)), None, 0.01)
    for pose in poses:
        graph.add(pose.array(), np.zeros(3))
    return graph


@pytest.fixture(scope="module")
def twice():
    """A drive along the middle of the corridor, and one beside it; neither sees an end."""
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, 0.05) for x in np.arange(10.0, 13.0, 0.4)]
    return graph_of([*old, *new], corridor(), LaserConfig(beams=181, fov=math.pi, max_range=6.0)), len(old)


def evidence_at(graph, old, shift):
    """What the newest scans say of a pose that is off along the corridor by `shift`."""
    pose = graph.poses[-1] + np.array([shift, 0.0, 0.0])
    return evidence_of(graph, np.arange(graph.count - 1, old - 1, -2), pose[None], [OldPass(graph, np.arange(old))])[0]


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


def test_where_old_scans_saw_nothing_there_is_no_evidence(twice):
    graph, old = twice
    far = evidence_of(
        graph, np.arange(graph.count - 1, old, -2), np.array([[60.0, 1.1, 0.0]]), [OldPass(graph, np.arange(old))]
    )[0]
    assert np.isnan(far.shares).all() and far.weight == 0.0


@pytest.mark.parametrize("laser", [ROUND, LaserConfig(beams=181, fov=math.pi, max_range=6.0)])
def test_scans_of_the_way_back_tell_about_a_place(laser):
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, math.pi) for x in np.arange(15.0, 10.0, -0.4)]
    graph = graph_of([*old, *new], corridor(), laser)
    keys = np.arange(graph.count - 1, len(old) - 1, -2)
    found = evidence_of(graph, keys, graph.poses[-1:], [OldPass(graph, np.arange(len(old)))])[0]
    assert np.isfinite(found.shares).sum() >= 5 and found.weight > 1.0
    hypothesis = Hypothesis(graph.poses[-1], OldPass(graph, np.arange(len(old))), False)
    place = verified(graph, graph.count - 1, np.arange(graph.count - 5, graph.count), hypothesis)
    assert place is not None and np.abs(between(graph.poses[-1], place.pose))[1:].max() < 0.02


def test_headings_on_both_sides_of_half_a_turn_agree(monkeypatch):
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, math.pi) for x in np.arange(15.0, 10.0, -0.4)]
    graph = graph_of([*old, *new], corridor(), ROUND)

    def split(*args):
        aligned = align_pairs(*args)
        aligned.poses[:, 2] = np.where(np.arange(len(aligned.poses)) % 2, math.pi - 1e-4, 1e-4 - math.pi)
        return aligned

    monkeypatch.setattr(place_search, "align_pairs", split)
    hypothesis = Hypothesis(graph.poses[-1], OldPass(graph, np.arange(len(old))), False)
    place = verified(graph, graph.count - 1, np.arange(graph.count - 4, graph.count), hypothesis)
    assert place is not None and len(place.links) == 6


def test_a_pair_that_says_another_pose_than_the_others_is_no_link(monkeypatch):
    old = [Pose(x, 1.1, 0.0) for x in np.arange(4.0, 16.0, 0.4)]
    new = [Pose(x, 1.2, 0.1) for x in np.arange(10.0, 15.0, 0.4)]
    graph = graph_of([*old, *new], corridor(), ROUND)

    def off(*args):
        aligned = align_pairs(*args)
        aligned.poses[2, 0] += 1.3
        return aligned

    recent = np.arange(graph.count - 6, graph.count)
    hypothesis = Hypothesis(graph.poses[-1], OldPass(graph, np.arange(len(old))), False)
    links = verified(graph, graph.count - 1, recent, hypothesis).links
    monkeypatch.setattr(place_search, "align_pairs", off)
    assert [k for _, k in verified(graph, graph.count - 1, recent, hypothesis).links] == [k for _, k in links if k != 2]
    assert 2 in [k for _, k in links]


def test_views_overlap_where_scans_look_at_one_place():
    ahead, away = Pose(8.0, 1.1, 0.0), Pose(15.0, 1.1, 0.0)
    graph = graph_of([ahead, away, Pose(13.0, 1.1, math.pi)], corridor(), HALF)
    assert graph.overlapping(2, graph.poses[2], np.arange(2), 4.0).tolist() == [0]
    behind = graph_of([ahead, Pose(8.5, 1.2, math.pi)], corridor(), HALF)
    assert not len(behind.overlapping(1, behind.poses[1], np.arange(1), 4.0))
    around = graph_of([ahead, Pose(8.5, 1.2, math.pi), Pose(8.8, 1.2, 0.1)], corridor(), ROUND)
    assert around.overlapping(2, around.poses[2], np.arange(2), 4.0).tolist() == [0, 1]


def test_a_place_that_explains_clearly_less_is_not_followed_further(twice):
    graph, old = twice
    keys, shifts = np.arange(graph.count - 1, old - 1, -1), np.array([0.0, -1.5, -PITCH])
    places = graph.poses[-1] + shifts[:, None] * (1.0, 0.0, 0.0)
    true, worse, alike = evidence_of(graph, keys, places, [OldPass(graph, np.arange(old))] * 3)
    tells = [int(np.isfinite(found.shares).sum()) for found in (true, worse, alike)]
    assert tells[0] == tells[2] == len(keys) > tells[1] and true.is_clearly_better(worse)


def test_places_are_compared_on_scans_that_tell_about_both():
    nothing = math.nan
    one = Evidence(np.zeros(3), np.array([0.9, 0.9, 0.9, nothing, nothing, nothing, nothing]))
    other = Evidence(np.zeros(3), np.array([0.85, 0.85, 0.85, 0.9, 0.9, nothing, nothing]))
    assert not one.is_clearly_better(other) and not other.is_clearly_better(one)
    poor = Evidence(np.zeros(3), np.array([0.75, 0.75, 0.7, nothing, nothing, nothing, nothing]))
    assert one.is_clearly_better(poor)
    unknown = Evidence(np.zeros(3), np.array([nothing, nothing, nothing, nothing, nothing, 0.9, 0.9]))
    assert not one.is_clearly_better(unknown)


def test_scans_are_followed_back_a_metre_apart():
    travelled = np.arange(0.0, 30.0, 0.3)
    back = followed_back(travelled, 90)
    assert back[0] == 90 and (np.diff(travelled[back]) < -0.6).all()
    assert travelled[90] - travelled[back[-1]] <= 13.0


@pytest.mark.parametrize("laser", [ROUND, HALF])
def test_what_is_explained_is_what_a_plain_loop_over_points_finds(laser):
    rng = np.random.default_rng(1)
    walls = corridor()
    poses = [Pose(9.0, 1.0, 0.1), Pose(9.6, 1.3, -0.2)]
    returns = stored(*(scan_at(pose, walls, laser, rng=rng) for pose in poses)).returns
    pose = between(poses[0].array(), poses[1].array()) + np.array([0.05, 0.02, 0.01])
    weight, visible, count = explained(returns, 0, 1, pose)
    points, normals, bearings = returns.points.astype(float), returns.normals.astype(float), bearings_at(returns, 0)
    total = np.zeros(3)
    for k in np.arange(0, bearings.beams, bearings.stride):
        if points[1, k, 2] == 0.0:
            continue
        total[2] += 1
        p = rotation(pose[2]) @ points[1, k, :2] + pose[:2]
        cell = (math.atan2(p[1], p[0]) - bearings.first) / bearings.spacing
        cell %= 2.0 * math.pi / bearings.spacing
        near = [math.floor(cell + 0.5) + d for d in (-1, 0, 1)]
        near = [q % bearings.beams for q in near if bearings.closed or 0 <= q < bearings.beams]
        seen = points[0, :, 2] > 0.0
        gaps = np.where(seen, np.hypot(*(p - points[0, :, :2]).T), np.inf)
        found, q = 0.0, int(np.argmin(gaps))
        agree = (rotation(pose[2]) @ normals[1, k, :2]) @ normals[0, q, :2]
        if gaps[q] < 0.12 and (agree >= 0.7 or not normals[1, k, :2].any() or not normals[0, q, :2].any()):
            r = gaps[q] if not normals[0, q, :2].any() else abs(normals[0, q, :2] @ (p - points[0, q, :2]))
            found = 1.0 / (1.0 + (r / 0.05) ** 2)
        far = max((points[0, q, 2] for q in near), default=0.0)
        total += (found, found > 0.0 or (far > 0.0 and math.hypot(*p) < far + 0.3), 0.0)
    # Beams that are far apart may find a partner farther away than the gate.
    assert weight == pytest.approx(total[0], rel=0.05) and count == total[2]
    assert visible == pytest.approx(total[1], abs=3)


def test_in_a_corridor_of_equal_doors_no_wrong_door_is_taken_and_the_scans_are_linked_once_it_is_clear():
    walls, laser = corridor(24.0), LaserConfig(beams=181, fov=math.pi, max_range=12.0)
    poses = drive(Pose(1.5, 1.1, 0.0), [(22.5, 1.1), (1.5, 1.15), (22.5, 1.05)], step=0.15)
    slam, truths = Slam(preset("log"), poses[0]), []
    with slam:
        for pose, tick in zip(poses, ticks(poses, walls, scale=1.02, drift=0.009, laser=laser), strict=True):
            if slam.take(tick).keyframe is not None:
                truths.append(pose.array())
    links, truths = slam._front_end.loop_closures.closings.links, np.array(truths)
    wrong = [np.hypot(*(between(truths[a.target], truths[a.source]) - a.pose)[:2]) for a in links]
    assert max(wrong) < 0.3
    third = [k for k, truth in enumerate(truths) if k > 0.7 * len(truths) and truth[0] > 3.0]
    linked = [link.source for link in links]
    near = [min(abs(k - j) for j in linked) <= 6 for k in third]
    assert np.mean(near) > 0.95
