"""The extent of a wall lies on the wall, where the robot is after the matches, and moves with it."""

import math

import numpy as np
import pytest

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose, rotation, wrap_angle
from sixthsense.core.landmark_kernels import line_ends
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.records import on_lines
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.estimators.base import Link

START = Pose(0.3, 0.2, 0.1)
OLD = (math.pi, -6.0, -3.0, 3.0), (-math.pi / 2.0, -4.0, -2.0, 5.0)
KNOWN = (*OLD, (0.0, -7.0, -3.0, 3.0), (0.5 * math.pi, -6.0, -4.0, 4.0))
NEW = (0.2, -5.0, -2.0, 1.0)
SIGMA = 0.002


def seen(pose, alpha, d, first, last):
    """A wall (alpha, d), from one place along it to another, as seen from a pose."""
    c, s = math.cos(alpha), math.sin(alpha)
    low, high = (place - (c * pose.y - s * pose.x) for place in (first, last))
    middle = 0.5 * (low + high)
    cov = SIGMA**2 * np.array([[1.0, middle], [middle, 1.0 + middle * middle]])
    z = np.array([wrap_angle(alpha - pose.theta), d - (c * pose.x + s * pose.y)])
    return Observation(Kind.WALL, z, cov, (low, high))


def keyframe(estimator, associator, pose, walls):
    association = associator.associate([seen(pose, *wall) for wall in walls], estimator)
    estimator.update(association.observations)
    estimator.forget(associator.forgotten(estimator, estimator.estimate()))
    return association


def places(record, wall):
    """First and last place along the wall, and the largest distance of an end from its line."""
    c, s = math.cos(wall[0]), math.sin(wall[0])
    return sorted(record.extent @ [-s, c]), float(np.abs(record.extent @ [c, s] - wall[1]).max())


@pytest.mark.parametrize("name", ["ekf", "ekf-invariant", "isam2"])
def test_extents_are_recorded_at_the_pose_that_the_matches_imply(name):
    """The prediction is off by 0.35 and 0.30 m, inside of its covariance."""
    estimator, associator = make_estimator(name, START, np.zeros((3, 3))), Associator(AssociationConfig())
    keyframe(estimator, associator, START, KNOWN)
    estimator.predict(Odometry(Pose(), np.diag([0.25, 0.25, 0.01]) ** 2))
    true = Pose(START.x + 0.35, START.y - 0.30, START.theta)
    # Two walls at right angles lie so wherever the robot is.
    assert not associator.associate([seen(true, *wall) for wall in OLD], estimator).observations
    assert len(keyframe(estimator, associator, true, (*KNOWN, NEW)).observations) == 5
    for i, wall in enumerate((*KNOWN, NEW)):
        (first, last), off = places(associator.records[i], wall)
        assert (first, last) == pytest.approx(wall[2:], abs=0.01) and off < 0.01


@pytest.mark.parametrize(("sigma_m", "is_slip"), [(0.02, True), (0.5, False)])
def test_no_slip_is_told_from_three_walls_where_the_pose_is_as_uncertain_without_one(sigma_m, is_slip):
    estimator, associator = make_estimator("ekf", START, np.zeros((3, 3))), Associator(AssociationConfig())
    keyframe(estimator, associator, START, KNOWN)
    estimator.predict(Odometry(Pose(), np.diag([sigma_m, sigma_m, 0.01]) ** 2))
    true = Pose(START.x + 0.35, START.y - 0.30, START.theta)
    found = associator.associate([seen(true, *wall) for wall in KNOWN[:3]], estimator)
    assert (found.slip is not None) == is_slip and len(found.observations) == (3 if is_slip else 0)


def test_extents_move_with_their_walls_when_a_loop_closes():
    estimator, associator = make_estimator("isam2", START, np.zeros((3, 3))), Associator(AssociationConfig())
    keyframe(estimator, associator, START, OLD)
    drive = Odometry(Pose(4.0, 0.5, 0.8), np.diag([0.5, 0.5, 0.2]) ** 2)
    estimator.predict(drive)
    there = START @ drive.motion
    wall = (wrap_angle(there.theta + 0.3), -20.0, 3.0, 7.0)
    keyframe(estimator, associator, there, [wall])
    before = associator.records[2].extent.copy()
    moved = Pose(3.6, 0.9, 0.9)
    estimator.link([Link(0, 1, Odometry(moved, 1e-8 * np.eye(3)))])
    estimate = estimator.estimate()
    associator.forgotten(estimator, estimate)
    landmark = estimate.landmarks[estimate.ids.tolist().index(2)]
    assert abs(wrap_angle(landmark[0] - wall[0]) - 0.1) < 0.01
    (first, last), off = places(associator.records[2], landmark)
    assert off < 1e-9 and last - first == pytest.approx(4.0, abs=1e-6)
    assert np.abs(before - associator.records[2].extent).max() > 0.1


@pytest.mark.parametrize("turn", [0.0, 0.4, math.pi])
def test_an_extent_keeps_its_length_its_middle_along_the_line_and_the_order_of_its_ends(turn):
    wall, other = np.array([0.7, 2.0]), np.array([0.7 + turn, 2.3])
    extent = line_ends(wall, -1.0, 2.5)
    moved = on_lines(other[None], extent[None])[0]
    normal, along = rotation(float(other[0])).T
    assert moved @ normal == pytest.approx([2.3, 2.3])
    assert moved.mean(axis=0) @ along == pytest.approx(extent.mean(axis=0) @ along)
    assert np.sign((moved[1] - moved[0]) @ (extent[1] - extent[0])) > 0.0
    assert np.hypot(*(moved[1] - moved[0])) == pytest.approx(3.5)
