"""Links and poses of the graph of keyframes, with an estimator that notes what it is told."""

import math

import numpy as np
import pytest
from rooms import HALF, ROOM, scan_at, stored

from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.graph import AGREEMENT, NO_KEYS, ScanGraph
from sixthsense.slam.scans.links import SEEN_SHARE, align_with, covariances
from sixthsense.slam.scans.tracking import Usual

MOUNT = np.array([0.23, -0.11, 0.6])
# The second looks away from much of what the first sees.
POSES = [Pose(-2.7, 1.4, 0.3), Pose(-2.4, 1.1, 2.75), Pose(-2.5, 1.6, 0.4)]


def robot_at(of_laser):
    return (of_laser @ Pose(*MOUNT).inverse()).array()


class Noting:
    """An estimator whose poses move by a known step with each question."""

    def __init__(self, of_laser):
        self.poses = np.array([robot_at(pose) for pose in of_laser])
        self.asked, self.ids, self.out = 0, 0, []

    def trajectory(self):
        self.asked += 1
        return compose(self.poses, np.array([0.01 * self.asked, 0.02, 0.0]))

    def poses_at(self, keys):
        return self.poses[keys]

    def link(self, links):
        first, self.ids = self.ids, self.ids + len(links)
        return list(range(first, self.ids))

    def unlink(self, ids):
        self.out += ids

    def take_out(self, keys):
        return [0]


@pytest.fixture
def graph():
    rng = np.random.default_rng(3)
    found = ScanGraph(stored(*(scan_at(pose, ROOM, HALF, rng=rng) for pose in POSES)), Noting(POSES), 0.01)
    for pose in POSES:
        found.add(pose.array(), MOUNT)
    for key in (1, 2):
        found.uncertainty.add(key - 1, key, 3e-4, 2e-5)
    return found


@pytest.mark.parametrize("is_old", [False, True])
def test_scans_are_linked_that_share_as_much_as_scans_usually_do(graph, is_old):
    found = align_with(graph.store.returns, np.array([0]), 1, graph.poses, 0.12)
    seen, through, count = found.views[0].T
    least = (seen / count).min() / SEEN_SHARE
    assert least < (seen / (seen + through)).min() / AGREEMENT and 0.1 < least < 0.95, "the share seen decides"
    for usual, is_linked in ((0.97 * least, True), (1.03 * least, False)):
        graph.usual = Usual(1.0 - usual, 0.5)
        before = len(graph.links)
        if is_old:
            graph.link(1, NO_KEYS, np.array([0]), None)
        else:
            graph.link(1, graph.recent(1), NO_KEYS, None)
        assert len(graph.links) - before == is_linked


@pytest.mark.parametrize(
    "change",
    [
        lambda graph, ids: graph.with_loss(ids, 2.5),
        lambda graph, ids: graph.remove(ids),
        lambda graph, ids: graph.take_out([1]),
    ],
)
def test_all_poses_are_read_anew_when_links_change(graph, change):
    ids = graph.link(2, NO_KEYS, np.array([0]), None)
    assert ids
    change(graph, ids)
    asked = graph.estimator.asked
    assert asked >= 1
    moved = compose(graph.estimator.poses, np.array([0.01 * asked, 0.02, 0.0]))
    assert graph.poses == pytest.approx(compose(moved, MOUNT), abs=1e-12)


def test_all_poses_are_read_anew_from_time_to_time(graph):
    for k in range(12):
        pose = Pose(-2.5 + 0.02 * k, 1.6, 0.4 + 0.01 * math.sin(k))
        graph.store.put(scan_at(pose, ROOM, HALF))
        graph.store.keep()
        graph.estimator.poses = np.vstack([graph.estimator.poses, robot_at(pose)])
        graph.add(pose.array(), MOUNT)
        graph.link(graph.count - 1, graph.recent(graph.count - 1), NO_KEYS, None)
    assert graph.estimator.asked == 1


@pytest.mark.parametrize("off_m", [0.0, 0.05])
def test_returns_count_less_where_links_fit_worse_than_they_state(graph, off_m):
    """By hand: of one link the redundancy is 0, so that its square stands beside a prior of 10 degrees of freedom.

    The square is weighted as in the graph, so that a link that is metres wrong says no more than one of 10 sigmas. The
    weights leave 0.777 of a chi-square of three degrees of freedom (by numerical integration with scipy).
    """
    graph.link(2, NO_KEYS, np.array([0]), None)
    for pose in graph.estimator.poses[1:]:
        pose[0] += off_m
    graph.refresh()
    ((i, link),) = graph.links.items()
    graph.links[i] = link._replace(scale=2.5)
    off = between(graph.poses[0], graph.poses[2])
    error = link.pose - off
    square = error @ np.linalg.inv(link.cov) @ error
    square /= 0.777 * (1.0 + square / 16.0)
    assert graph.variance_factor() == pytest.approx((square + 10.0) / 10.0)
    expected = max(1.0, (2.5 * square + 10.0) / 10.0)
    assert graph.scale() == pytest.approx(expected) and (graph.scale() > 2.0) == (off_m > 0.0)
    graph.usual = Usual(0.2, 0.5)
    found = align_with(graph.store.returns, np.array([0]), 1, graph.poses, 0.25)
    graph.link(1, NO_KEYS, np.array([0]), None)
    newest = graph.links[1]
    assert (newest.target, newest.source) == (0, 1) and newest.scale == pytest.approx(expected)
    np.testing.assert_allclose(newest.cov, expected * covariances(found.sums, np.array([2.0]), 0.01)[0], rtol=1e-9)


def test_a_link_that_is_far_off_says_no_more_of_the_others_than_one_of_many_sigmas(graph):
    graph.link(2, NO_KEYS, np.array([0]), None)
    graph.estimator.poses[1:, 0] += 40.0
    graph.refresh()
    assert graph.squares([*graph.links])[0] > 1e6
    assert graph.variance_factor() == pytest.approx((16.0 / 0.777 + 10.0) / 10.0, rel=1e-4)
