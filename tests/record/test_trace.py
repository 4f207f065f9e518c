"""What the loop adds to a trace, and what follows from it."""

import dataclasses

import numpy as np
import pytest
from traces import CONFIG, cov_of, observation_of, pose_of

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Tick
from sixthsense.record.trace import Trace
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.features import NO_FEATURES
from sixthsense.slam.front_end import Keyframe
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.result import Step

WAY = [(1.5, -2.0), (4.5, 2.0), (9.5, 14.0), (9.5, 15.5)]  # 5 m, 13 m, 1.5 m
CARRIED = np.diag([0.3**2, 1e-6, 1e-6])


@pytest.fixture
def trace() -> Trace:
    return Trace(CONFIG, None, 0.23)


@pytest.mark.parametrize("has_truth", [True, False])
def test_the_way_is_that_of_the_true_pose_if_there_is_one_and_leaves_out_where_the_robot_was_carried(
    has_truth: bool, trace: Trace
) -> None:
    for k, place in enumerate(WAY):
        other = Pose(-7.0 * k, 3.0)
        truth, odometry = (Pose(*place), other) if has_truth else (None, Pose(*place))
        trace.add_tick(Tick(k, Pose(5.0 * k), truth=truth), odometry, is_carried=k == 2)
    assert trace.path_length_m == pytest.approx(6.5) and trace.last_position == pytest.approx(WAY[-1])


def test_a_scan_and_its_keyframe_are_added_with_what_was_believed_before_and_after(trace: Trace) -> None:
    rng = np.random.default_rng(3)
    motion = Odometry(pose_of(rng), cov_of(rng))
    predicted, estimate = (Estimate.of_pose(pose_of(rng), cov_of(rng)) for _ in range(2))
    found = Association({4: observation_of(rng, Kind.END)}, 3, 2.5, 2, 1)
    features = dataclasses.replace(NO_FEATURES, walls=rng.normal(size=(2, 2, 2)))
    keyframe = Keyframe(0, motion, predicted, estimate, found, features)
    people = rng.normal(size=(2, 3))
    poses = [pose_of(rng) for _ in range(8)]
    grid = Grid(CONFIG.grid, 0.23)
    before = Step(5, poses[0], poses[1], None, Odometry(poses[2], cov_of(rng)), None, None, grid)
    trace.add_scan(Tick(5, poses[3], truth=poses[4], walkers=people, touches=(1, 2)), before)
    tick = Tick(9, poses[3], truth=poses[7], walkers=2 * people, touches=(3, 5), log_stamp_s=1.25)
    scan = Scan(np.array([1.5, np.inf, 2.25], np.float32), np.float32(-0.5), np.float32(0.25), 7.5)
    trace.add_keyframe(tick, keyframe, scan, is_measured=False)
    trace.add_scan(tick, Step(9, poses[5], poses[6], motion, Odometry(Pose(), cov_of(rng)), None, keyframe, grid))
    assert trace.stamps_ns == [5, 9] and np.array_equal(trace.log_stamps_s, [np.nan, 1.25], equal_nan=True)
    rows = {"estimates": (0, 5), "odometry": (1, 6), "truths": (4, 7)}
    for name, indices in rows.items():
        assert np.array_equal(getattr(trace, name), [poses[k].array() for k in indices]), name
    assert np.array_equal(trace.since_key, [poses[2].array(), np.zeros(3)]) and trace.last_key == [-1, 0]
    assert np.array_equal(trace.walkers, [people, 2 * people]) and trace.touches == (3, 5)
    assert trace.key_stamps_ns == [9] and np.array_equal(trace.key_truths, [poses[7].array()])
    for found_one, expected in ((trace.key_predicted[0], predicted), (trace.key_estimates[0], estimate)):
        assert found_one.pose == expected.pose and np.array_equal(found_one.pose_cov, expected.pose_cov)
    assert trace.key_odometry == [motion] and trace.associations == [found]
    assert np.array_equal(trace.walls_found[0], features.walls)
    assert trace.key_scans == [scan] and trace.key_measured == [False]
