"""Keyframes of places that are known well leave the graph."""

import itertools

import numpy as np
import pytest
from rooms import ROOM, drive, ticks

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.slam.scans.graph import LINKS
from sixthsense.slam.scans.uncertainty import UncertaintyGraph
from sixthsense.slam.slam import Slam

CONFIG = preset(front_end="scan-matching", scans={"final_pass": False})
LAP = [(3.0, -2.0), (3.0, 2.0), (-3.0, 2.0), (-3.0, -2.0)]


def laps(count, seed=0):
    """A `Slam` after laps of a room, the errors (K, 3) of its key poses, and the number that is kept after each lap."""
    poses = drive(Pose(-3.0, -2.0, 0.0), LAP * count)
    sizes, truth = [], []
    with Slam(CONFIG, poses[0]) as slam:
        graph = slam._front_end._graph
        for k, tick in enumerate(ticks(poses, ROOM, seed=seed)):
            if slam.take(tick).keyframe is not None:
                truth.append(poses[k].array())
            if (k + 1) % (len(poses) // count) == 0:
                sizes.append(int(graph.is_kept.sum()))
        error = slam.finish().trajectory - np.array(truth)
        error[:, 2] = wrap_angle(error[:, 2])
    return slam, error, sizes


@pytest.mark.slow
def test_the_graph_stops_growing_where_the_robot_has_been():
    slam, error, sizes = laps(12)
    graph = slam._front_end._graph
    assert sizes[-1] - sizes[-4] < 0.2 * (sizes[2] - sizes[1]) * 3
    assert graph.count > 1.5 * sizes[-1] and len(error) == graph.count
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.03 and np.abs(error[:, 2]).max() < 0.02
    kept = graph.is_kept
    assert all(kept[link.target] and kept[link.source] for link in graph.links.values())


def test_what_is_seen_a_few_times_stays():
    slam, _, _ = laps(3)
    assert slam._front_end._graph.is_kept.all()


def test_new_territory_stays_bound_to_the_keyframes_before_it(monkeypatch):
    """A keyframe leaves only if those that are linked to it are known by old ones."""
    thinning = laps(3)[0]._front_end.loop_closures._thinning
    graph = thinning._graph
    key = graph.count - 30
    old = {k: [k % 40, k % 40 + 1] for k in range(graph.count)}
    monkeypatch.setattr(graph, "linked_old", lambda k: old.get(k, []))
    graph.poses[:] = 0.0
    assert thinning._is_spare(key)
    for k in (key, key + LINKS):
        olds = old.pop(k)
        assert not thinning._is_spare(key)
        old[k] = olds
    old.pop(key + LINKS + 1)
    assert thinning._is_spare(key)


def test_uncertainty_along_a_chain_does_not_change_when_keyframes_leave():
    whole, less = UncertaintyGraph(), UncertaintyGraph()
    poses = np.column_stack([np.arange(30.0), np.zeros(30), np.zeros(30)])
    for graph, k in itertools.product((whole, less), range(29)):
        graph.add(k, k + 1, 1e-4 * (k + 1), 1e-5, bias_m=0.001)
        if k > 20:
            graph.add(k - 20, k, 1e-3, 1e-3, group=0)
    less.take_out([10, 11, 12, 15])
    less.take_out([16])
    (a, b), (c, d) = whole.sigmas(29, poses), less.sigmas(29, poses)
    # The heading counts by the farthest keyframe on the path, which is an end of it here.
    kept = np.setdiff1d(np.arange(17, 30), [10])
    assert np.allclose(a[kept], c[kept]) and np.allclose(b[kept], d[kept])
    assert c[15] == c[14] and c[16] == c[14] and c[10] == c[9] and c[12] == c[9]
    assert np.isfinite(c).all()
    less.remove([0])
    whole.remove([0])
    (a, _), (c, _) = whole.sigmas(0, poses), less.sigmas(0, poses)
    assert np.allclose(a[[9, 13, 14, 17, 29]], c[[9, 13, 14, 17, 29]], rtol=0.05)
