"""Trajectory and landmarks of a run as pandas frames."""

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.core.landmarks import Kind

pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def run() -> ss.Run:
    """Walls and free ends."""
    return ss.run("apartment", task="tour", max_time=8.0, progress=False)


def test_a_trajectory_has_a_row_per_keyframe(explored: ss.Run) -> None:
    trace, frame = explored.trace, explored.trajectory.frame()
    assert frame.index.tolist() == trace.key_stamps_ns and len(frame) == len(explored.trajectory)
    last = trace.key_estimates[-1]
    assert frame[["x", "y", "theta"]].iloc[-1].tolist() == last.pose.array().tolist()
    assert frame[["sigma_x", "sigma_y", "sigma_theta"]].iloc[-1].tolist() == np.sqrt(np.diag(last.pose_cov)).tolist()
    assert np.array_equal(frame[["x_final", "y_final", "theta_final"]], trace.trajectory)
    assert np.array_equal(frame[["x_true", "y_true", "theta_true"]], np.array(trace.key_truths))
    assert frame["nees"].mean() == pytest.approx(explored.metrics["pose_nees_world_mean"])
    assert frame["time_s"].iloc[0] == 0.0 and frame["distance_m"].is_monotonic_increasing


def test_landmarks_have_what_their_kind_has(run: ss.Run) -> None:
    trace, frame = run.trace, run.landmarks.frame()
    assert frame.index.tolist() == trace.final.ids.tolist() and len(frame) == len(run.landmarks)
    is_wall = trace.final.walls
    assert 0 < is_wall.sum() < len(is_wall)
    walls, points = frame[is_wall], frame[~is_wall]
    assert set(walls["kind"]) == {"wall"} and set(points["kind"]) <= {kind.name.lower() for kind in Kind} - {"wall"}
    assert np.array_equal(walls[["alpha", "d"]], trace.final.landmarks[is_wall])
    assert np.array_equal(points[["x", "y"]], trace.final.landmarks[~is_wall])
    assert walls[["x", "y", "sigma_x"]].isna().all(axis=None) and points[["alpha", "from_x"]].isna().all(axis=None)
    first = walls.index[0]
    assert (
        walls.loc[first, ["from_x", "from_y", "to_x", "to_y"]].tolist() == trace.records[first].extent.ravel().tolist()
    )
    row = int(np.flatnonzero(is_wall)[0])
    assert walls.loc[first, "sigma_d"] == pytest.approx(trace.joint_cov[4 + 2 * row, 4 + 2 * row] ** 0.5)
    assert frame["observations"].tolist() == [trace.records[i].observations for i in frame.index]
