"""Keyframes leave a smoother's graph, with what they observed, where enough others show the same."""

import math

import gtsam
import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised
from point_world import POINTS, START, joint_state, make, noisy, sight, step
from predicted import predict_walls

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Link
from sixthsense.slam.estimators.thinning import OLD_AGE, PERIOD, Thinning, is_crowded

CONFIG = ISAM2Config(undo_probability=1.0)
WALLS = np.array([[0.0, -6.0], [math.pi / 2, -5.0], [math.pi, -6.0]])
WALL_COV = np.diag([1e-5, 1e-4])
LANDMARKS = np.vstack([POINTS, np.zeros((5, 2)), WALLS])  # by id: walls are 10, 11, 12


def observations_from(true, rng):
    """Of all points and walls."""
    z = predict_walls(true, WALLS)[0] + rng.multivariate_normal(np.zeros(2), WALL_COV, len(WALLS))
    walls = {10 + k: Observation(Kind.WALL, z[k], WALL_COV, (-1.0, 1.0)) for k in range(len(WALLS))}
    return sight(true, range(len(POINTS)), rng) | walls


def circling(seed, steps, thins):
    """A smoother after rounds among the same landmarks, the true poses (K, 3), and which poses were taken out."""
    rng, true, truth, gone = np.random.default_rng(seed), START, [], []
    smoother = make("isam2", START, np.zeros((3, 3)), CONFIG)
    for k in range(steps):
        smoother.predict(step())
        true = true @ noisy(step(), rng)
        smoother.update(observations_from(true, rng))
        truth.append(true.array())
        if thins and k % 10 == 9 and k > 20:
            leaving = list(range(k - 19, k - 11))
            smoother.take_out(leaving)
            gone += leaving
    return smoother, np.array(truth), gone


def test_the_trajectory_has_all_poses_and_the_graph_those_that_are_kept():
    (one, truth, gone), (two, _, _) = circling(1, 100, True), circling(1, 100, False)
    in_graph = len(gtsam.utilities.allPose2s(one._graph.isam.calculateEstimate()).keys()) - len(WALLS)
    assert in_graph == 100 - len(gone) and one.trajectory().shape == truth.shape
    gap, off = one.trajectory() - two.trajectory(), two.trajectory() - truth
    gap[:, 2], off[:, 2] = wrap_angle(gap[:, 2]), wrap_angle(off[:, 2])
    assert np.abs(gap).max() < 0.06
    few = [0, gone[3], 60, 99]
    assert np.allclose(one.poses_at(few), one.trajectory()[few], rtol=0.0, atol=1e-12)


def test_pose_and_map_are_consistent_with_poses_taken_out():
    rows = []
    for seed in range(8):
        smoother, truth, _ = circling(seed, 80, True)
        estimate, joint = joint_state(smoother)
        whole = error_of(estimate, Pose.from_array(truth[-1]), LANDMARKS)
        rows.append([normalised(whole[:3], joint[:3, :3]), normalised(whole, joint)])
    for values, freedom in zip(np.array(rows).T, (3, 19), strict=True):
        assert_consistent(values, freedom)


def test_a_link_to_a_pose_that_was_taken_out_is_one_to_the_pose_it_is_fixed_to():
    (one, truth, gone), (two, _, _) = circling(3, 100, True), circling(3, 100, False)
    for before, after in ((gone[5], 99), (3, gone[-1])):
        motion = Pose.from_array(truth[before]).inverse() @ Pose.from_array(truth[after])
        link = Link(before, after, Odometry(motion, 1e-4 * np.eye(3)))
        ids = [smoother.link([link]) for smoother in (one, two)]
        assert np.abs(one.trajectory()[:, :2] - two.trajectory()[:, :2]).max() < 0.06
        one.unlink(ids[0])
        two.unlink(ids[1])


@pytest.mark.parametrize(("shift", "turn", "crowded"), [(0.4, 0.3, True), (0.6, 0.0, False), (0.0, 0.4, False)])
def test_a_keyframe_is_spare_where_eight_others_are_near_it_and_look_the_same_way(shift, turn, crowded):
    poses = np.vstack([np.tile([2.0 + shift, -1.0, 3.1 + turn], (8, 1)), [[2.0, -1.0, 3.1]]])
    poses[:, 2] = wrap_angle(poses[:, 2])
    assert is_crowded(poses, np.ones(9, dtype=bool), 8) is crowded
    assert not is_crowded(poses, np.arange(9) > 0, 8)


def test_keyframes_leave_ten_at_a_time_once_they_are_old_but_for_those_that_are_needed():
    poses, thinning, left = np.zeros((60, 3)), Thinning(), []
    for count in range(1, 61):
        kept = ~np.isin(np.arange(count), left)
        leaving = thinning.leaving(poses[:count], kept, lambda k: k == 12)
        assert len(leaving) in (0, PERIOD) and (not leaving or max(leaving) < count - OLD_AGE)
        left += leaving
    assert left == [*range(8, 12), *range(13, 29)]
