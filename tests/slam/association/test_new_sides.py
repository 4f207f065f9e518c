"""Points that are seen from a new side: the known one, or the end of the wall's other face."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.corners import Corner, Scatter
from sixthsense.slam.estimators import make_estimator
from sixthsense.testing.sight import predict_points

ESTIMATORS = ["ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2"]
NOISE = np.diag([0.003, 0.0045]) ** 2
START = Pose(-2.7, 0.4, 0.3)
NEAR_THE_START = np.array([[-0.8, 1.9], [-0.5, -1.6], [0.3, 0.1]])
MOTION_M, MOTION_RAD = 0.004, 0.002
"""sigma of a motion between two keyframes"""


def sight(pose, points, rng=None):
    """Free ends (k, 2) as seen from a pose; without errors where nothing draws them."""
    z = predict_points(pose, points)[0]
    if rng is not None:
        z = z + rng.multivariate_normal(np.zeros(2), NOISE, len(z))
    return [Observation(Kind.END, each, NOISE) for each in z]


def beyond(name, sigma_m, ends, turned=()):
    """The associator, and what it says of `ends` (k, 2) that are seen from beyond them.

    It knows the points near the start, seen from there. Each of the points `turned` (k, 2) was seen from beyond as
    well, which tells how many are others.
    """
    estimator = make_estimator(name, START, np.zeros((3, 3)))
    associator = Associator(AssociationConfig())
    far = Pose(3.9, 0.8, -2.6)
    known = np.concatenate([NEAR_THE_START, np.reshape(turned, (-1, 2))])
    estimator.update(associator.associate(sight(START, known), estimator).observations)
    estimator.predict(Odometry(START.inverse() @ far, np.diag([1e-8, 1e-8, 1e-10])))
    for point in known[3:]:
        estimator.update(associator.associate(sight(far, point[None]), estimator).observations)
    estimator.predict(Odometry(Pose(), np.diag([sigma_m**2, sigma_m**2, 1e-8])))
    return associator.associate(sight(far, ends), estimator), max(associator.records)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_other_end_of_a_thick_wall_is_a_new_point_however_near_and_closes_no_loop(name):
    other = NEAR_THE_START[2:] + np.array([0.11, 0.02])
    both = np.concatenate([NEAR_THE_START[:2], other])
    certain, newest = beyond(name, 0.001, both)
    assert sorted(certain.observations) == [0, 1, 3] and newest == 3
    # 0.11 m pass the gate of a robot that is uncertain by 0.05 m; the end is as likely another one.
    lone, newest = beyond(name, 0.05, other)
    assert (len(lone.observations), lone.discarded, newest) == (0, 1, 2)


def test_the_other_end_is_none_where_the_scan_says_that_the_pose_is_wrong():
    """Two of three points are not where they are expected: the place of none says anything."""
    off = NEAR_THE_START + np.array([[0.0, 0.0], [-0.13, 0.06], [0.11, 0.02]])
    associator = Associator(AssociationConfig())
    estimator = make_estimator("ekf", START, np.zeros((3, 3)))
    estimator.update(associator.associate(sight(START, NEAR_THE_START), estimator).observations)
    far = Pose(3.9, 0.8, -2.6)
    estimator.predict(Odometry(START.inverse() @ far, np.diag([1e-6, 1e-6, 1e-8])))
    found = associator.associate(sight(far, off), estimator)
    assert sorted(found.observations) == [0] and found.discarded == 2


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_known_end_is_matched_from_beyond_by_how_many_were_the_same(name):
    """The limit by hand, for an end exactly where it is expected: the share of others over the disc, by the odds."""
    end = NEAR_THE_START[2:]
    turned = [(-0.4, 2.4 + 0.7 * k) for k in range(12)]
    own = 2.0 * math.sqrt(np.linalg.det(NOISE))  # of both sights
    for told, others in (((), 1.0 / 2.0), (turned, 1.0 / 14.0)):
        density = 1000.0 * others / (math.pi * 0.3**2)
        largest = 1.0 / (2.0 * math.pi * density)  # of the root of the determinant of the innovation's covariance
        assert beyond(name, math.sqrt(0.9 * largest - own), end, told)[0].dof == 2
        assert beyond(name, math.sqrt(1.1 * largest - own), end, told)[0].dof == 0


def test_a_side_counts_once_and_one_that_comes_gradually_is_not_new():
    corner, scatter = Corner(), Scatter()

    def look(side_rad):
        pose = Pose(2.0 * math.cos(side_rad), 2.0 * math.sin(side_rad), 0.4)
        corner.seen(sight(pose, np.zeros((1, 2)))[0], pose, scatter, 0.0)

    assert not corner.is_new_side(2.0)  # nobody has seen it
    look(1.0)
    assert not corner.is_new_side(1.12) and corner.is_new_side(1.2)
    look(1.12)  # like the first side, and not kept as one of its own
    assert not corner.is_new_side(1.2) and corner.is_new_side(0.8)
    look(1.2)
    look(1.36)
    assert corner.is_new_side(1.6) and not corner.is_new_side(1.04)
    assert corner.counts(1.6) and not corner.counts(1.7) and corner.counts(-1.6)
    assert corner.is_new_side(1.6)  # counted is not seen


def test_what_is_matched_with_a_point_says_nothing_of_another_one_beside_it():
    """The far corner is known from its side, then the near one from the other: only that is counted."""
    near, far = np.array([[0.3, 0.1]]), np.array([[0.35, 0.13]])
    others = np.array([[-0.8, 1.9], [-0.5, -1.6], [0.9, 1.2]])
    behind = Pose(3.9, 0.8, -2.6)
    estimator, associator = make_estimator("ekf", START, np.zeros((3, 3))), Associator(AssociationConfig())
    exact = np.diag([1e-10, 1e-10, 1e-12])
    place = START
    for pose, seen in ((behind, far), (START, near), (behind, far), (START, near)):
        estimator.predict(Odometry(place.inverse() @ pose, exact))
        place = pose
        shown = np.concatenate([others, seen]) if pose is START else seen
        for _ in range(2):
            estimator.update(associator.associate(sight(pose, shown), estimator).observations)
    # The other three are seen from the start alone.
    assert len(associator.records) == 5
    assert associator._unknown._from_new_side == pytest.approx(1.0)


def drive(name, seed, thick_m):
    """NEES of the pose at each keyframe of two rounds about the ends of seven walls, and how many points it knows.

    An end is a corner of the face that the robot is in front of; the corners of both faces are `thick_m` apart.
    """
    rng = np.random.default_rng(seed)
    ends, walls_rad = rng.uniform(-2.0, 2.0, (7, 2)), rng.uniform(-math.pi, math.pi, 7)
    while min(math.dist(ends[i], ends[k]) for i in range(7) for k in range(i)) < 0.9:
        ends = rng.uniform(-2.0, 2.0, (7, 2))
    normals = np.column_stack([np.cos(walls_rad), np.sin(walls_rad)])
    poses = [Pose(3.6 * math.cos(a), 2.9 * math.sin(a), a + 1.9) for a in np.linspace(0.3, 0.3 + 4.0 * math.pi, 120)]
    estimator, associator = make_estimator(name, poses[0], np.zeros((3, 3))), Associator(AssociationConfig())
    cov = np.diag([MOTION_M**2, MOTION_M**2, MOTION_RAD**2])
    nees = []
    for before, pose in itertools.pairwise(poses):
        error = rng.multivariate_normal(np.zeros(3), cov)
        estimator.predict(Odometry((before.inverse() @ pose) @ Pose(*error), cov))
        in_front = np.sign(np.sum((pose.position - ends) * normals, axis=1))
        corners = ends + (0.5 * thick_m * in_front)[:, None] * normals
        shown = corners[rng.permutation(len(ends))[:5]]
        estimator.update(associator.associate(sight(pose, shown, rng), estimator).observations)
        estimate = estimator.estimate()
        off = np.append(estimate.pose.position - pose.position, (pose.inverse() @ estimate.pose).theta)
        nees.append(off @ np.linalg.solve(estimate.pose_cov, off))
    return float(np.mean(nees)), len(estimator.estimate().ids)


@pytest.mark.parametrize("thick_m", [0.0, 0.05, 0.21])
def test_rounds_about_walls_are_consistent_be_they_thin_or_thick(thick_m):
    """Over 24 seeds; a run has about four independent values of three degrees of freedom."""
    found = [drive("ekf-invariant", 100 * int(1000 * thick_m) + seed, thick_m) for seed in range(24)]
    nees = np.array([mean for mean, _ in found])
    low, high = chi2.ppf([0.001, 0.999], 3 * 4 * 24) / (4 * 24)
    assert low < nees.mean() < high, nees.round(1)
    points = np.mean([points for _, points in found])
    assert points == 7.0 if thick_m == 0.0 else points > 11.0
