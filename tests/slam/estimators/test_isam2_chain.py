"""Poses that add nothing to the map are taken out of the smoother's graph."""

import math

import gtsam
import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised
from point_world import POINTS, START, driven, joint_state, make, noisy, sight, step
from predicted import predict_walls

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Link
from sixthsense.slam.estimators.isam2_chain import map_gain

SPARING = ISAM2Config(undo_probability=1.0, least_gain=0.05)
KEEPING = SPARING.replaced(least_gain=0.0)
WALLS = np.array([[0.0, -6.0], [math.pi / 2, -5.0], [math.pi, -6.0]])
WALL_COV = np.diag([1e-5, 1e-4])
LANDMARKS = np.vstack([POINTS, np.zeros((5, 2)), WALLS])  # by id: walls are 10, 11, 12


def observations_from(true, rng):
    """Of all points and walls."""
    z = predict_walls(true, WALLS)[0] + rng.multivariate_normal(np.zeros(2), WALL_COV, len(WALLS))
    walls = {10 + k: Observation(Kind.WALL, z[k], WALL_COV, (-1.0, 1.0)) for k in range(len(WALLS))}
    return sight(true, range(len(POINTS)), rng) | walls


def circling(config, seed, steps=200, at=lambda estimator, k, true: None, asks=True):
    """A smoother after rounds among the same landmarks, and the true poses (K, 3)."""
    rng, true, truth = np.random.default_rng(seed), START, []
    smoother = make("isam2", START, np.zeros((3, 3)), config)
    for k in range(steps):
        smoother.predict(step())
        true = true @ noisy(step(), rng)
        if asks:
            smoother.joint_covariance(smoother.estimate().ids.tolist())  # as the association asks for it
        smoother.update(observations_from(true, rng))
        truth.append(true.array())
        at(smoother, k, true)
    return smoother, np.array(truth)


def in_graph(smoother):
    """Number of poses that the solver has."""
    return len(gtsam.utilities.allPose2s(smoother._solver.isam.calculateEstimate()).keys()) - len(WALLS)


def test_the_gain_is_what_the_observations_say_of_the_landmarks():
    """As the ratio of the determinants of the landmarks' covariance without and with them."""
    estimator = driven("ekf")
    estimate, joint = joint_state(estimator)
    true = estimate.pose
    seen = sight(true, estimate.ids.tolist(), np.random.default_rng(1))
    found = map_gain(true, joint, estimate.landmarks, estimate.walls, [seen[i] for i in estimate.ids.tolist()])
    _, by_pose, by_landmark = predictions(true.triple(), estimate.landmarks, estimate.walls)
    H = np.zeros((10, 13))
    H[:, :3] = by_pose.reshape(10, 3)
    for k in range(5):
        H[2 * k : 2 * k + 2, 3 + 2 * k : 5 + 2 * k] = by_landmark[k]
    after = np.linalg.inv(np.linalg.inv(joint) + H.T @ H / 0.05**2)
    ratio = np.linalg.det(joint[3:, 3:]) / np.linalg.det(after[3:, 3:])
    assert found == pytest.approx(0.5 * math.log(ratio) / 5, rel=1e-6)


def test_the_graph_stops_growing_where_the_robot_has_been():
    sizes = []
    smoother, truth = circling(
        SPARING, 0, 400, lambda estimator, k, _: k % 100 == 99 and sizes.append(in_graph(estimator))
    )
    assert sizes[-1] < 1.2 * sizes[1] and sizes[-1] < 120
    assert smoother.trajectory().shape == truth.shape
    assert in_graph(circling(KEEPING, 0, 100)[0]) == 100


def test_asking_for_a_covariance_changes_no_later_estimate():
    asked, unasked = (circling(SPARING, 3, 120, asks=asks)[0] for asks in (True, False))
    assert in_graph(asked) == in_graph(unasked) < 100
    np.testing.assert_allclose(joint_state(asked)[1], joint_state(unasked)[1], rtol=1e-6)
    np.testing.assert_allclose(asked.trajectory(), unasked.trajectory(), atol=1e-9)


def test_the_whole_trajectory_stays_near_that_with_all_poses():
    """Poses that were taken out move with those they are fixed to."""
    (one, truth), (two, _) = circling(SPARING, 1), circling(KEEPING, 1)
    gap, off = one.trajectory() - two.trajectory(), two.trajectory() - truth
    gap[:, 2], off[:, 2] = wrap_angle(gap[:, 2]), wrap_angle(off[:, 2])
    assert np.abs(gap).max() < 0.06
    assert np.sqrt((one.trajectory()[:, :2] - truth[:, :2]) ** 2).mean() < 1.3 * np.sqrt(off[:, :2] ** 2).mean()
    few = [0, 57, 120, 199]
    assert np.allclose(one.poses_at(few), one.trajectory()[few], rtol=0.0, atol=1e-12)


def test_pose_and_map_are_consistent_with_poses_taken_out():
    """16 runs with many more key poses than stay."""
    rows = []
    for seed in range(16):
        smoother, truth = circling(SPARING, seed, 80)
        estimate, joint = joint_state(smoother)
        whole = error_of(estimate, Pose.from_array(truth[-1]), LANDMARKS)
        rows.append([normalised(whole[:3], joint[:3, :3]), normalised(whole, joint)])
        assert len(estimate.ids) == 8 and in_graph(smoother) < 60
    for values, freedom in zip(np.array(rows).T, (3, 19), strict=True):
        assert_consistent(values, freedom)


def test_a_link_to_a_pose_that_was_taken_out_is_one_to_the_pose_it_is_fixed_to():
    (one, truth), (two, _) = circling(SPARING, 3, 100), circling(KEEPING, 3, 100)
    gone = next(k for k in range(20, 100) if one._chain.anchored(k)[0] != k)
    for before, after in ((gone, 99), (3, gone)):
        motion = Pose.from_array(truth[before]).inverse() @ Pose.from_array(truth[after])
        link = Link(before, after, Odometry(motion, 1e-4 * np.eye(3)))
        ids = [smoother.link([link]) for smoother in (one, two)]
        assert np.abs(one.trajectory()[:, :2] - two.trajectory()[:, :2]).max() < 0.06
        one.unlink(ids[0])
        two.unlink(ids[1])
