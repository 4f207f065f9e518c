"""Keyframes of places that are known well leave the graph."""

import numpy as np
import pytest
from rooms import ROOM, drive, ticks

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
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
    assert graph.is_kept[graph.links["ends"]].all()


def test_what_is_seen_a_few_times_stays():
    slam, _, _ = laps(3)
    assert slam._front_end._graph.is_kept.all()
