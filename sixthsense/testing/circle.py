"""The landmark circle: a drive with known association and the same measurements for every estimator.

The setup is the 2-D SLAM benchmark of the UKF-M package (Brossard, Barrau and Bonnabel, ICRA 2020), after Huang,
Mourikis and Roumeliotis (IJRR 29(5), 2010): 10.4 rounds within a ring of 20 landmarks, odometry with constant noise of
speed and turn rate, landmarks measured in the robot frame, an exact start. The true path is the circle without noise;
only measurements have noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.arcs import arc_jacobian
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry, rk4
from sixthsense.evaluation.metrics import full_rank_from, nees_invariant, nees_world
from sixthsense.slam.estimators import EstimatorFactory
from sixthsense.testing.batch import to_robot
from sixthsense.testing.estimators import make

STEPS, STEP_S = 2500, 1.0
SPEED, TURN_RATE = 0.25, math.radians(1.5)  # m/s, rad/s
SIGMA_SPEED, SIGMA_TURN_RATE = 0.05 * SPEED / math.sqrt(2.0), 0.05 * SPEED * 2.0 * math.sqrt(2.0)  # m/s, rad/s
RADIUS = SPEED / TURN_RATE
LANDMARKS, LANDMARKS_OUTSIDE = 20, 3.0  # m from the driven circle
SIGMA_POINT, NEAREST, FARTHEST = 0.1, 1.0, 5.0  # m

ODOMETRY_COV = np.diag([(SIGMA_SPEED * STEP_S) ** 2, (SIGMA_TURN_RATE * STEP_S) ** 2])
POINT_COV = SIGMA_POINT**2 * np.eye(2)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The measurements and the truth of one run."""

    truth: Array
    """(K, 3) poses at the end of each step"""
    odometry: tuple[Odometry, ...]
    """K increments"""
    observations: tuple[dict[LandmarkId, Observation], ...]
    """K, each at the end of its step"""
    full_rank_from: int
    """first step at which the covariance has full rank; the noise of one step has rank 2"""


@dataclass(frozen=True, slots=True)
class Track:
    """Errors and NEES of one estimator in one run, per step; NEES is NaN before the covariance has full rank."""

    position_m: Array
    """(K,) position error, m"""
    heading: Array
    """(K,) heading error, rad"""
    nees3: Array
    """(K,) pose NEES, world coordinates"""
    nees3_invariant: Array
    """(K,) pose NEES, right-invariant coordinates"""
    nees_heading: Array
    """(K,) heading NEES"""
    step_ms: float
    """mean time of predict and update, ms"""


def landmarks() -> Array:
    """(20, 2) landmarks on a circle concentric with the robot's, world frame."""
    angle = 2.0 * math.pi * np.arange(LANDMARKS) / LANDMARKS
    ring = (RADIUS + LANDMARKS_OUTSIDE) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(ring + np.array([0.0, RADIUS]))


def simulate(seed: int, run: int, steps: int = STEPS) -> Evidence:
    """Simulate the measurements of run number `run`, which depend only on seed and number."""
    rng = np.random.default_rng([seed, run])
    turn = TURN_RATE * STEP_S * np.arange(1, steps + 1)
    truth = np.stack([RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)), turn], axis=1)
    truth[:, 2] = wrap_angle(truth[:, 2])
    points = landmarks()
    odometry, observations, motion, covs = [], [], STANDSTILL, []
    for row in truth:
        speed = SPEED + SIGMA_SPEED * rng.standard_normal()
        turn_rate = TURN_RATE + SIGMA_TURN_RATE * rng.standard_normal()
        g = arc_jacobian(speed * STEP_S, turn_rate * STEP_S)
        odometry.append(Odometry(rk4(Pose(), speed, turn_rate, STEP_S), g @ ODOMETRY_COV @ g.T))
        motion = motion.then(odometry[-1])
        covs.append(motion.cov)
        z = np.array([to_robot(row, point, False) for point in points])
        z_range = np.hypot(z[:, 0], z[:, 1])
        z += SIGMA_POINT * rng.standard_normal(z.shape)
        seen = np.flatnonzero((z_range > NEAREST) & (z_range < FARTHEST)).tolist()
        observations.append({i: Observation(Kind.CORNER, z[i], POINT_COV) for i in seen})
    return Evidence(truth, tuple(odometry), tuple(observations), full_rank_from(np.array(covs)))


def follow(name: str | EstimatorFactory, evidence: Evidence, isam2: ISAM2Config | None = None) -> Track:
    """Run an estimator, by its name or its class, on the measurements."""
    settings = isam2 or ISAM2Config(undo_probability=1.0)  # all matches are correct
    estimator = make(name, Pose(), np.zeros((3, 3)), settings)
    poses, covs, spent_s = [], [], 0.0
    for odometry, observations in zip(evidence.odometry, evidence.observations, strict=True):
        began = perf_counter()
        estimator.predict(odometry)
        estimator.update(observations)
        spent_s += perf_counter() - began
        now = estimator.estimate()
        poses.append(now.pose.array())
        covs.append(now.pose_cov)
    estimate, cov = np.array(poses), np.array(covs)
    error = estimate - evidence.truth
    error[:, 2] = wrap_angle(error[:, 2])
    nees = np.full((3, len(estimate)), math.nan)
    full = slice(evidence.full_rank_from, None)
    nees[0, full] = nees_world(error[full], cov[full])
    nees[1, full] = nees_invariant(estimate[full], evidence.truth[full], cov[full])
    nees[2, full] = error[full, 2] ** 2 / cov[full, 2, 2]
    step_ms = 1e3 * spent_s / len(estimate)
    return Track(np.hypot(error[:, 0], error[:, 1]), error[:, 2], nees[0], nees[1], nees[2], step_ms)
