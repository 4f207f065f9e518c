"""Rounds about walls whose ends are seen from both of their faces."""

import itertools
import math

import numpy as np
import pytest
from point_world import make
from predicted import predict_points
from scipy.stats import chi2

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.associator import Associator

NOISE = np.diag([0.003, 0.0045]) ** 2
MOTION = np.diag([0.004, 0.004, 0.002]) ** 2
SEEDS = 10


def drive(seed, thick_m):
    """NEES of the pose, a mean over two rounds about the ends of seven walls, and how many points it knows.

    An end is a corner of the face that the robot is in front of; the corners of both faces are `thick_m` apart.
    """
    rng = np.random.default_rng(seed)
    ends, walls_rad = rng.uniform(-2.0, 2.0, (7, 2)), rng.uniform(-math.pi, math.pi, 7)
    while min(math.dist(ends[i], ends[k]) for i in range(7) for k in range(i)) < 0.9:
        ends = rng.uniform(-2.0, 2.0, (7, 2))
    normals = np.column_stack([np.cos(walls_rad), np.sin(walls_rad)])
    poses = [Pose(3.6 * math.cos(a), 2.9 * math.sin(a), a + 1.9) for a in np.linspace(0.3, 0.3 + 4.0 * math.pi, 120)]
    estimator, associator = make("ekf-invariant", poses[0], np.zeros((3, 3))), Associator(AssociationConfig())
    nees = []
    for before, pose in itertools.pairwise(poses):
        error = rng.multivariate_normal(np.zeros(3), MOTION)
        estimator.predict(Odometry((before.inverse() @ pose) @ Pose(*error), MOTION))
        in_front = np.sign(((pose.position - ends) * normals).sum(axis=1))
        corners = ends + (0.5 * thick_m * in_front)[:, None] * normals
        z, _, _ = predict_points(pose, corners[rng.permutation(7)[:5]])
        seen = [Observation(Kind.END, each, NOISE) for each in z + rng.multivariate_normal(np.zeros(2), NOISE, len(z))]
        estimator.update(associator.associate(seen, estimator).observations)
        estimate = estimator.estimate()
        off = np.append(estimate.pose.position - pose.position, (pose.inverse() @ estimate.pose).theta)
        nees.append(off @ np.linalg.solve(estimate.pose_cov, off))
    return float(np.mean(nees)), len(estimator.estimate().ids)


@pytest.mark.parametrize(("thick_m", "points"), [(0.0, 7), (0.05, 14), (0.21, 14)])
def test_rounds_about_walls_are_consistent_be_they_thin_or_thick(thick_m, points):
    """A run has about four independent values of three degrees of freedom."""
    found = [drive(100 * int(1000 * thick_m) + seed, thick_m) for seed in range(SEEDS)]
    low, high = chi2.ppf([0.001, 0.999], 3 * 4 * SEEDS) / (4 * SEEDS)
    assert low < np.mean([nees for nees, _ in found]) < high
    assert {known for _, known in found} == {points}
