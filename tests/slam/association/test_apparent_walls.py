"""Walls as they appear: what the shape of a wall has in common from one observation to the next."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.observed import ends
from sixthsense.slam.association.records import Footprint, Record, less_certain
from sixthsense.slam.estimators import make_estimator

FILTERS = ["ekf", "ekf-fej", "ekf-oc", "ekf-invariant"]


def footprint(first, last, robot=(0.0, -2.0)):
    """Of a wall along the x axis, seen from a place."""
    return Footprint.of(Pose(*robot, 0.0), np.array([[first, 0.0], [last, 0.0]]))


def wall_from(pose, cov):
    """The wall y = 0 as it is seen from a pose."""
    z = np.array([wrap_angle(math.pi / 2 - pose.theta), -pose.y])
    return Observation(Kind.WALL, z, cov, (-1.0, 1.0))


def seen_as(observation, kept=None, **fields):
    """The observation of a wall that is not straight with this in common with earlier ones."""
    if kept is not None:
        fields["renewal"] = 2.0 * (1.0 - kept) * observation.bend.cov
    return replace(observation, bend=observation.bend._replace(**fields))


def filtered(name, seen):
    """A filter that has seen a wall from one place, several times."""
    estimator = make_estimator(name, Pose(0.0, -2.0, 0.3), np.zeros((3, 3)))
    for observation in seen:
        estimator.update({0: observation})
    return estimator


@pytest.mark.parametrize("name", FILTERS)
def test_an_error_of_shape_that_stays_is_counted_once(name):
    """However often it is observed, the line is known no better than by its shape; without it, ever better."""
    clean = wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 1e-6]))
    crooked = less_certain(clean, 1e-4)
    stays = filtered(name, [crooked, *[seen_as(crooked, kept=1.0)] * 50])
    once = less_certain(clean, 1e-4).cov
    variance = stays.joint_covariance([0])[4, 4]
    assert variance < 1e-6  # as it appears from here, the wall is known well
    anew = filtered(name, [crooked, *[seen_as(crooked, kept=0.0)] * 50]).joint_covariance([0])[4, 4]
    assert variance < anew < 2.0 * once[1, 1]


@pytest.mark.parametrize("name", FILTERS)
def test_a_wall_that_is_seen_otherwise_says_less_of_the_pose(name):
    """The robot has moved uncertainly; a wall of which the same is seen locates it, another stretch does less."""
    clean = wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 1e-6]))
    crooked = less_certain(clean, 1e-4)
    variances = []
    for kept in (1.0, 0.5, 0.0):
        estimator = filtered(name, [crooked, *[seen_as(crooked, kept=1.0)] * 5])
        estimator.predict(Odometry(Pose(), np.diag([1e-2, 1e-2, 1e-6])))
        estimator.update({0: seen_as(crooked, kept=kept)})
        variances.append(estimator.estimate().pose_cov[1, 1])
    assert variances[0] < variances[1] < variances[2] < 1e-3


@pytest.mark.parametrize("stretches", [[0], [0] * 20, [0, 1, 2, 3], [0, 0, 1, 1, 1, 2] * 3])
def test_in_the_smoother_each_stretch_has_one_error(stretches):
    """The wall has the information of its stretches, each with its shape's covariance and the mean of its scans'."""
    clean = wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 4e-6]))
    crooked = less_certain(clean, 1e-4)
    estimator = filtered("isam2", [seen_as(crooked, stretch=k) for k in stretches])
    counts = np.bincount(stretches)
    information = sum(np.linalg.inv(crooked.bend.cov + clean.cov / n) for n in counts)
    about_robot = estimator.joint_covariance([0])[3:, 3:]
    assert about_robot[0, 0] == pytest.approx(np.linalg.inv(information)[0, 0], rel=1e-3)
    x, y = 0.0, -2.0  # the landmark's offset is from the world's origin, the observed one from the robot
    lever = np.array([[1.0, 0.0], [math.cos(math.pi / 2) * y - math.sin(math.pi / 2) * x, 1.0]])
    assert about_robot == pytest.approx(lever @ np.linalg.inv(information) @ lever.T, rel=1e-3, abs=1e-12)


def test_in_the_smoother_a_stretch_that_was_seen_says_more_of_the_pose():
    clean = wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 1e-6]))
    crooked = less_certain(clean, 1e-4)
    variances = []
    for stretch in (0, 1):
        estimator = filtered("isam2", [crooked] * 6)
        estimator.predict(Odometry(Pose(), np.diag([1e-2, 1e-2, 1e-6])))
        estimator.update({0: seen_as(crooked, stretch=stretch)})
        variances.append(estimator.estimate().pose_cov[1, 1])
    assert variances[0] < 1e-5 < 1e-4 < variances[1] < 3e-4


def test_in_the_smoother_what_a_scan_does_not_share_with_its_stretch_is_noise():
    """The information of a wall is that of observations with errors of one part in common."""
    clean = wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 4e-6]))
    crooked, alike = less_certain(clean, 1e-4), 0.8
    estimator = filtered("isam2", [seen_as(crooked, stretch_kept=alike)] * 5)
    own = (clean.cov + (1.0 - alike**2) * crooked.bend.cov) / 5
    assert estimator.joint_covariance([0])[3, 3] == pytest.approx((crooked.bend.cov + own)[0, 0], rel=1e-3)


def test_apparent_walls_go_with_their_wall():
    crooked = less_certain(wall_from(Pose(0.0, -2.0, 0.3), np.diag([1e-6, 1e-6])), 1e-4)
    estimator = make_estimator("isam2", Pose(0.0, -2.0, 0.3), np.zeros((3, 3)))
    for stretch in (0, 1):
        estimator.update({0: seen_as(crooked, stretch=stretch), 1: crooked})
    estimator.forget([0])
    estimator.update({1: seen_as(crooked, stretch=1), 2: crooked})
    assert estimator.estimate().landmarks == pytest.approx(np.tile([math.pi / 2, 0.0], (2, 1)), abs=1e-6)
    assert len(estimator.trajectory()) == 3


def test_a_wall_has_a_stretch_for_each_place_that_shows_another_error():
    record = Record(Kind.WALL, 1, 0, 0)
    seen = [footprint(-1.0, 1.0), footprint(-0.8, 1.0), footprint(3.0, 5.0), footprint(-1.0, 0.8), footprint(3.1, 5.0)]
    assert [record.stretch_of(each) for each in [*seen, footprint(-1.0, 1.0, (0.0, 2.0))]] == [0, 0, 1, 0, 1, 2]


def test_ends_of_a_wall_are_its_footprint():
    pose = Pose(0.5, -2.0, 0.3)
    seen = ends(pose, wall_from(pose, np.eye(2)))
    assert np.allclose(seen[:, 1], 0.0) and Footprint.of(pose, seen).side_rad < 0.0
