"""The factor graph of a run says what its smoother says; in `test_round_trips.py` GTSAM reads the file."""

from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.loop.run import run
from sixthsense.record.exports import graph_arrays
from sixthsense.record.trace import Trace

Graph = SimpleNamespace  # of the arrays
KEEP = {"cull_below": 0}  # a culled landmark's observations are in the solver's past, and not in the graph


@pytest.fixture(scope="module", params=["isam2", "ekf"])
def trace(request: pytest.FixtureRequest) -> Trace:
    corners = {"features": {"landmarks": "corners"}, "association": KEEP}  # the file has no tag for walls
    return run(preset(scene="apartment", estimator=request.param, task="tour", max_time=40.0, seed=2, **corners))


@pytest.fixture(scope="module")
def graph(trace: Trace) -> Graph:
    return SimpleNamespace(**graph_arrays(trace))


def solve(graph: Graph) -> np.ndarray:
    """(K, 3) poses of the graph's optimum, from its arrays."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.poses):
        values.insert(k, gtsam.Pose2(*pose))
    for j, point in enumerate(graph.landmarks):
        values.insert(gtsam.symbol("l", j), point)
    start = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), start))
    gaussian = gtsam.noiseModel.Gaussian.Covariance
    for k, (motion, cov) in enumerate(zip(graph.motions, graph.motion_covs, strict=True)):
        factors.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*motion), gaussian(cov)))
    rows = zip(graph.observation_of, graph.bearing_range, graph.bearing_range_covs, strict=True)
    for (k, j), (bearing, distance), cov in rows:
        key = gtsam.symbol("l", j)
        factors.add(gtsam.BearingRangeFactor2D(k, key, gtsam.Rot2(bearing), distance, gaussian(cov)))
    return gtsam.utilities.extractPose2(gtsam.LevenbergMarquardtOptimizer(factors, values).optimize())


def test_the_graphs_optimum_is_what_the_smoother_had_found(graph: Graph, trace: Trace) -> None:
    moved = solve(graph) - graph.poses
    if trace.config.estimator == "isam2":
        # The incremental solver leaves alone what would move by less than its threshold, 0.01.
        assert np.abs(moved).max() < 1e-3
    assert np.abs(moved).max() < 0.03
