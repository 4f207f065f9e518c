"""The factor graph of a run says what its smoother says; in `test_round_trips.py` GTSAM reads the file."""

from pathlib import Path
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import between
from sixthsense.logs import open_log
from sixthsense.loop.run import replay, run
from sixthsense.record.exports import graph_arrays, write_g2o
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


def test_our_own_reader_replays_the_graph_that_a_run_has_left(graph: Graph, trace: Trace, tmp_path: Path) -> None:
    write_g2o(tmp_path / "graph.g2o", trace)
    log = open_log(tmp_path / "graph.g2o", LaserConfig())
    assert sum(len(tick.observations or {}) for tick in log.ticks) == len(graph.bearing_range)
    trace = replay(log, preset("victoria", estimator="isam2", start=None))
    moved = (
        trace.trajectory[-1] - (Pose.from_array(graph.poses[0]).inverse() @ Pose.from_array(graph.poses[-1])).array()
    )
    assert np.hypot(*moved[:2]) < 0.05


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


def test_the_links_of_scan_matching_are_edges_that_gtsam_reads(tmp_path):
    made = run(preset(scene="rectangle", front_end="scan-matching", estimator="isam2", task="tour", max_time=12.0))
    links = made.links
    write_g2o(tmp_path / "graph.g2o", made)
    graph, _ = gtsam.readG2o(str(tmp_path / "graph.g2o"))
    assert len(links.ends) > 10 and graph.size() == len(made.key_odometry) - 1 + len(links.ends)
    assert len(graph_arrays(made)["link_ends"]) == len(links.ends)
    apart = between(made.trajectory[links.ends[:, 0]], made.trajectory[links.ends[:, 1]]) - links.motions
    assert np.abs(apart[:, :2]).max() < 0.02
