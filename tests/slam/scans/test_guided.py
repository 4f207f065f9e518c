"""Landmarks whose matches are chosen where scan matching says that the robot is."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from rooms import CORNERS, RING, drive, ticks

from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.source import Tick
from sixthsense.slam.slam import Slam

CONFIG = preset("log", front_end="landmarks", features={"landmarks": "both"})
POSES = drive(Pose(-9.0, -6.0, 0.0), CORNERS + CORNERS[:2])
TRUTH = np.array([pose.array() for pose in POSES])
SLIP_AT, SLIP = 300, Pose(0.0, 0.5, 0.3)


def slipping() -> Iterator[Tick]:
    """Ticks of a drive with bad wheels that slip once."""
    for k, tick in enumerate(ticks(POSES, RING, scale=1.03, drift=0.03)):
        yield dataclasses.replace(tick, odometry=tick.odometry @ (SLIP if k >= SLIP_AT else Pose()))


def errors(config: Config) -> Array:
    """(N,) position errors of the smoothed key poses and the odometry since."""
    since: list[tuple[int, Pose]] = []
    keys = -1
    with Slam(config, POSES[0]) as slam:
        for tick in slipping():
            step = slam.take(tick)
            keys += step.keyframe is not None
            since.append((keys, step.since.motion))
        result = slam.finish()
    poses = np.array([(Pose.from_array(result.trajectory[k]) @ motion).array() for k, motion in since])
    return np.asarray(np.hypot(*(poses - TRUTH)[:, :2].T))


@pytest.mark.parametrize("estimator", ["isam2", "ekf-invariant"])
def test_landmarks_survive_a_slip_where_aligned_scans_propose_the_pose(estimator: str) -> None:
    config = merge(CONFIG, {"estimator": estimator})
    found = errors(config)
    found[SLIP_AT : SLIP_AT + 3] = 0.0  # until the next keyframe the odometry is all that is known
    # Walls hold the pose: the ends of walls are seen from new sides, from places that are known to 5 cm.
    assert found.max() < 0.25 and np.sqrt(np.mean(found**2)) < 0.08
    assert errors(merge(config, {"association": {"proposed_by": "estimate"}})).max() > 3.0 * found.max()


def test_a_proposal_is_no_measurement() -> None:
    config = merge(CONFIG, {"features": {"lines": {"min_points": 400}, "points": {"min_points": 400}}})
    with Slam(config, POSES[0]) as slam:
        for tick in ticks(POSES[:200], RING, scale=1.05, drift=0.1):
            step = slam.take(tick)
        result = slam.finish()
    assert not len(result.estimate.ids) and result.loop_closures is not None
    assert np.allclose(step.pose.array(), step.dead_reckoned.array(), atol=1e-9)  # odometry alone


def test_observations_that_a_log_names_are_used_beside_proposals_by_scans() -> None:
    """Scans at every other keyframe, and named landmarks in between: both count, and no motion counts twice."""
    named = {1000: np.array([-5.0, -4.0]), 1001: np.array([-7.0, -8.0])}
    cov = 1e-4 * np.eye(2)
    config = merge(CONFIG, {"estimator": "ekf-invariant"})
    used = []
    with Slam(config, POSES[0]) as slam:
        for k, tick in enumerate(ticks(POSES[:200], RING, scale=1.0, drift=0.0)):
            if k % 10 == 5:
                here = POSES[k].inverse()
                seen = {i: Observation(Kind.CORNER, here @ at, cov) for i, at in named.items()}
                tick = dataclasses.replace(tick, scan=None, observations=seen)
            step = slam.take(tick)
            if tick.observations:
                assert step.keyframe is not None
                used.append(step.keyframe.association.observations.keys() == named.keys())
        result = slam.finish()
        rows, columns = np.nonzero(slam.grid.obstacles)
        x, y = slam.grid.origin
        cell_m = config.grid.cell_m
        obstacles = np.column_stack([x + (columns + 0.5) * cell_m, y + (rows + 0.5) * cell_m])
    off = np.min([point_segment_distance(point, RING) for point in obstacles], axis=1)
    assert len(obstacles) > 500 and np.max(off) < 0.15  # the map draws a scan at its own keyframe
    assert len(used) == 20 and all(used)
    landmarks = dict(zip(result.estimate.ids.tolist(), result.estimate.landmarks, strict=True))
    assert all(np.allclose(landmarks[i], at, atol=0.05) for i, at in named.items())
    off = step.pose.array() - POSES[199].array()
    assert np.hypot(off[0], off[1]) < 0.05
