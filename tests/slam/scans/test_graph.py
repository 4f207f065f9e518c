"""Links, poses and uncertainty of the graph of keyframes, with an estimator that records what it is given."""

import itertools

import numpy as np
import pytest
from rooms import HALF, ROOM, scan_at, stored

from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import between, compose
from sixthsense.slam.estimators.thinning import OLD_AGE
from sixthsense.slam.scans.graph import ScanGraph
from sixthsense.slam.scans.links import AGREEMENT, NEAR_GATE_M, SEEN_SHARE, Alignments, align_pairs, covariances
from sixthsense.slam.scans.tracking import Usual

MOUNT = np.array([0.23, -0.11, 0.6])
# The second looks away from much of what the first sees.
POSES = [Pose(-2.7, 1.4, 0.3), Pose(-2.4, 1.1, 2.75), Pose(-2.5, 1.6, 0.4)]
NONE, NO_KEYS = -1, np.zeros(0, dtype=np.int64)


def robot_at(of_laser):
    return (of_laser @ Pose(*MOUNT).inverse()).array()


class Recording:
    """An estimator whose poses move by a known step with each question."""

    def __init__(self, of_laser):
        self.poses = np.array([robot_at(pose) for pose in of_laser])
        self.asked, self.ids, self.step_m, self.held = 0, 0, 0.01, {}

    def trajectory(self):
        self.asked += 1
        return compose(self.poses, np.array([self.step_m * self.asked, 0.0, 0.0]))

    def poses_at(self, keys):
        return self.poses[keys]

    def link(self, links):
        first, self.ids = self.ids, self.ids + len(links)
        self.held |= dict(zip(range(first, self.ids), links, strict=True))
        return list(range(first, self.ids))

    def unlink(self, ids):
        for i in ids:
            del self.held[i]

    def take_out(self, keys):
        return [0]


def graph_of(of_laser):
    rng = np.random.default_rng(3)
    found = ScanGraph(stored(*(scan_at(pose, ROOM, HALF, rng=rng) for pose in of_laser)), Recording(of_laser), 0.01)
    found.mount = MOUNT
    for k, pose in enumerate(of_laser):
        found.add(pose.array())
        if k:
            found.moved(0.3, 3e-4, 2e-5)
    return found


@pytest.fixture
def graph():
    return graph_of(POSES)


@pytest.mark.parametrize("is_old", [False, True])
def test_scans_are_linked_that_share_as_much_as_scans_usually_do(graph, is_old):
    start = between(graph.poses[:1], graph.poses[1]).reshape(-1, 3)
    found = align_pairs(graph.store.returns, np.array([0]), np.array([1]), start, NEAR_GATE_M)
    _, seen, through, count = found.seen[0].T
    least = (seen / count).min() / SEEN_SHARE
    assert least < (seen / (seen + through)).min() / AGREEMENT and 0.1 < least < 0.95, "the share seen decides"
    for usual, is_linked in ((0.97 * least, True), (1.03 * least, False)):
        graph.usual, before = Usual(1.0 - usual, 0.5), len(graph.links)
        graph.first = int(is_old)  # a robot that was carried since is at an old place, if at any
        graph.link(1, np.array([0]) if is_old else NO_KEYS, NONE)
        assert len(graph.links) - before == is_linked


@pytest.mark.parametrize(
    "change", [lambda graph: graph.remove(np.ones(1, dtype=bool)), lambda graph: graph.take_out([1])]
)
def test_all_poses_are_read_anew_when_links_change(graph, change):
    graph.first = 2
    graph.link(2, np.array([0]), NONE)
    assert len(graph.links) == 1
    change(graph)
    assert not len(graph.links) and graph.estimator.asked >= 1
    moved = compose(graph.estimator.poses, np.array([0.01 * graph.estimator.asked, 0.0, 0.0]))
    assert graph.poses == pytest.approx(compose(moved, MOUNT), abs=1e-12)


def chain(count):
    """Keyframes 0.3 m apart on a line, of a laser at the robot's centre."""
    of_laser = [Pose(0.3 * k, 0.0, 0.0) for k in range(count)]
    graph = ScanGraph(stored(*[scan_at(Pose(), ROOM, HALF)] * count), Recording(of_laser), 0.01)
    graph.estimator.poses, graph.estimator.step_m = np.array([pose.array() for pose in of_laser]), 0.0
    for k, pose in enumerate(of_laser):
        graph.add(pose.array())
        if k:
            graph.moved(0.3, 1e-4, 1e-6)
    return graph


def test_keyframes_are_old_if_they_are_of_an_earlier_pass_or_from_before_the_robot_was_carried():
    graph = chain(50)
    assert graph.old(49).tolist() == list(range(49 - OLD_AGE))
    graph.first = 40
    assert graph.old(49).tolist() == list(range(40))
    graph.take_out([7])
    assert graph.old(49).tolist() == [k for k in range(40) if k != 7]


def alignments(ends, hessian, errors=None):
    """Aligned pairs of a `chain`, `errors` (m, 3) off their true poses."""
    m = len(ends)
    targets, sources = np.array(ends, dtype=np.int64).T
    poses = np.column_stack([0.3 * (sources - targets), np.zeros((m, 2))]) + (0.0 if errors is None else errors)
    return Alignments(targets, sources, poses, np.tile(hessian, (m, 1, 1)), np.full(m, 90.0), np.zeros((m, 2, 4)))


@pytest.mark.parametrize("batches", [(8,), (4, 4), (1, 7), (3, 3, 2), (8, 40)])
def test_the_information_of_a_scans_links_is_bounded_and_the_same_in_whatever_order_they_come(batches):
    graph, hessian, target = chain(60), np.diag([80.0, 60.0, 90.0]), 0
    for size in batches:
        ends = [(k, 59) for k in range(target, target + size)]
        graph.give(alignments(ends, hessian), np.ones(size, dtype=np.bool_), NONE)
        target += size
    total = sum(np.linalg.inv(cov) for cov in graph.links["cov"])
    pair, n = np.linalg.inv(covariances(hessian[None], 0.01)[0]), sum(batches)
    independent = graph.factor * np.trace(total) / np.trace(pair)
    assert independent == pytest.approx(n / (1.0 + (n - 1.0) / 16.0), rel=1e-6) and independent < 16.0
    # The links fit without any error, so several were given again, in place of those before.
    held = graph.estimator.held
    assert (graph.factor < 0.7) == (batches[0] > 1) and sorted(held) == sorted(graph.links["id"])
    for row in graph.links:
        link = held[row["id"]]
        assert link.relative.cov == pytest.approx(row["cov"], rel=1e-9)
        assert row["weight"] * row["cov"] == pytest.approx(np.linalg.inv(pair), rel=1e-9)
        assert link.loss_scale == pytest.approx(4.0 / graph.factor**0.5)


@pytest.mark.parametrize("stated", [1.0, 4.0])
def test_the_variance_factor_of_independent_links_is_that_of_their_errors(stated):
    """Four links a keyframe, stated right or at a quarter of their variance, about poses by least squares."""
    rng, count, hessian = np.random.default_rng(5), 120, np.diag([80.0, 60.0, 90.0])
    graph = chain(count)
    ends = [(k - d, k) for k in range(1, count) for d in range(1, 5) if k >= d]
    (cov,) = covariances(hessian[None], 0.01)
    errors = rng.multivariate_normal(np.zeros(3), stated * cov, len(ends))
    # Of heading the errors are so small that the poses are linear in them.
    errors[:, 2] = 0.0
    system = np.zeros((len(ends), count))
    for row, (a, b) in zip(system, ends, strict=True):
        row[a], row[b] = -1.0, 1.0
    fitted = np.zeros((count, 3))
    fitted[1:, :2] = np.linalg.lstsq(system[:, 1:], errors[:, :2], rcond=None)[0]
    graph.estimator.poses = graph.poses + fitted
    for key in range(1, count):
        rows = [k for k, end in enumerate(ends) if end[1] == key]
        found = alignments([ends[k] for k in rows], hessian, errors[rows])
        graph.give(found, np.zeros(len(rows), dtype=np.bool_), NONE)
    # Two of three coordinates have errors.
    assert graph._fitted_factor() == pytest.approx(2.0 / 3.0 * stated, rel=0.2)


def test_uncertainties_are_the_least_over_all_ways_along_the_graph():
    """Where an error of heading counts by the distance from the newest keyframe, parts of best ways are best ways."""
    rng, n = np.random.default_rng(0), 7
    graph = graph_of([Pose(*rng.uniform(-2.0, 2.0, 2), 0.3 * k) for k in range(n)])
    graph._keyframes["step"][:n] = rng.uniform([1e-3, 1e-4], [0.1, 0.02], (n, 2))
    ends = [(0, 4), (1, 6), (2, 5), (0, 6), (2, 5), (3, 4)]  # of two between the same keyframes the better one counts
    graph.give(alignments(ends, np.diag([0.5, 0.7, 0.9]) + 6.0 * np.eye(3)), np.ones(6, dtype=np.bool_), NONE)
    graph.factor = 0.6  # their returns state more
    links, poses = graph.links, graph.poses
    arcs = [((k, k + 1), *graph._keyframes["step"][k + 1]) for k in range(n - 1)]
    covs = [row["cov"] / 0.6 for row in links]
    arcs += [
        (tuple(row["ends"]), np.linalg.eigvalsh(c[:2, :2])[1], c[2, 2]) for row, c in zip(links, covs, strict=True)
    ]

    def cost(way, k):
        total = 0.0
        for pair in itertools.pairwise(way):
            lever = poses[max(pair), :2] - poses[n - 1, :2]
            costs = [(p + h * lever @ lever, h)[k] for ends, p, h in arcs if ends == tuple(sorted(pair))]
            total += min(costs, default=1e6)
        return total

    sigma_m, sigma_rad = graph.sigmas(n - 1)
    for key in range(n - 1):
        others = [k for k in range(n - 1) if k != key]
        ways = [(key, *middle, n - 1) for m in range(n - 1) for middle in itertools.permutations(others, m)]
        assert sigma_m[key] ** 2 == pytest.approx(min(cost(way, 0) for way in ways))
        assert sigma_rad[key] ** 2 == pytest.approx(min(cost(way, 1) for way in ways))
    assert sigma_m[n - 1] == 0.0
