"""Poses that are taken out of the smoother's graph by request, with their links."""

import numpy as np
from laws.links import linked

from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Link


def test_a_pose_that_was_taken_out_stays_where_it_was_beside_the_one_before_it():
    smoother = linked("isam2")
    smoother.take_out([4])
    before = smoother.trajectory()
    smoother.link([Link(0, 3, Odometry(Pose(2.0, 1.0, 1.9), 1e-6 * np.eye(3)))])
    after = smoother.trajectory()
    assert np.abs(after - before).max() > 0.1
    kept, moved = (Pose.from_array(rows[3]).inverse() @ Pose.from_array(rows[4]) for rows in (before, after))
    assert np.allclose(kept.array(), moved.array(), atol=1e-9)
