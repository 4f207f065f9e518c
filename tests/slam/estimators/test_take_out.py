"""Poses that are taken out of the smoother's graph by request, with their links."""

import numpy as np
from laws.links import linked
from point_world import assert_same, joint_state, make, step

from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry, WheelTerms
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.wheels import PARAMETERS, Wheels
from sixthsense.slam.estimators import Link


def seen(smoother, before, after, off=0.01):
    """A link that differs a little from where a smoother has the poses."""
    poses = [Pose.from_array(row) for row in smoother.trajectory()[[before, after]]]
    return Link(before, after, Odometry(poses[0].inverse() @ poses[1] @ Pose(off, -off, off), 1e-3 * np.eye(3)))


def test_a_pose_that_was_taken_out_stays_where_it_was_beside_the_one_before_it():
    smoother = linked("isam2")
    smoother.take_out([4])
    before = smoother.trajectory()
    smoother.link([Link(0, 3, Odometry(Pose(2.0, 1.0, 1.9), 1e-6 * np.eye(3)))])
    after = smoother.trajectory()
    assert np.abs(after - before).max() > 0.1
    kept, moved = (Pose.from_array(rows[3]).inverse() @ Pose.from_array(rows[4]) for rows in (before, after))
    assert np.allclose(kept.array(), moved.array(), atol=1e-9)


def test_with_the_wheels_as_a_variable_the_motions_still_depend_on_them():
    whole, less = (make("isam2") for _ in range(2))
    prior, jacobian = ParameterEstimate(Wheels(), 1e-4 * np.eye(PARAMETERS)), np.eye(3, PARAMETERS)
    for smoother in (whole, less):
        smoother.calibrate(prior)
        for _ in range(6):
            smoother.predict(Odometry(step().motion, step().cov, WheelTerms(Wheels(), 0.1 * jacobian)))
            smoother.update({})
        smoother.link([seen(smoother, 0, 5)])
    less.take_out([2, 3])
    assert_same(joint_state(whole), joint_state(less), 1e-5)
    assert np.allclose(whole.calibration(Wheels).cov, less.calibration(Wheels).cov, rtol=1e-3)
    assert np.allclose(whole.calibration(Wheels).values.array(), less.calibration(Wheels).values.array(), atol=1e-5)
