"""The landmark circle: a drive with known association, on the same evidence for every estimator.

The set-up is the 2-D SLAM benchmark of the UKF-M package (Brossard, Barrau and Bonnabel, ICRA 2020), after Huang,
Mourikis and Roumeliotis (IJRR 29(5), 2010): 10.4 rounds within a ring of 20 landmarks, odometry with constant noise of
speed and turn rate, landmarks seen in the robot's frame, an exactly known start. The way driven is the circle without
noise; the noise is that of the measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Sighting, predict_points
from sixthsense.core.motion import STANDSTILL, Odometry, arc_jacobian, rk4
from sixthsense.evaluation.metrics import full_rank_from, nees_invariant, nees_world
from sixthsense.slam.estimators import make_estimator

STEPS, STEP_S = 2500, 1.0
SPEED, TURN_RATE = 0.25, math.radians(1.5)  # m/s, rad/s
SIGMA_SPEED, SIGMA_TURN_RATE = 0.05 * SPEED / math.sqrt(2.0), 0.05 * SPEED * 2.0 * math.sqrt(2.0)  # m/s, rad/s
RADIUS = SPEED / TURN_RATE
LANDMARKS, LANDMARKS_OUTSIDE = 20, 3.0  # m from the circle that is driven
SIGMA_POINT, NEAREST, FARTHEST = 0.1, 1.0, 5.0  # m

ODOMETRY_COV = np.diag([(SIGMA_SPEED * STEP_S) ** 2, (SIGMA_TURN_RATE * STEP_S) ** 2])
POINT_COV = SIGMA_POINT**2 * np.eye(2)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one run measured, and the truth."""

    truth: Array
    """(K, 3) poses at the end of each step"""
    odometry: tuple[Odometry, ...]
    """K increments"""
    sightings: tuple[dict[LandmarkId, Sighting], ...]
    """K, each at the end of its step"""
    full_rank_from: int
    """the first step at which the covariance has full rank: speed and turn rate err in two directions at a time"""


@dataclass(frozen=True, slots=True)
class Track:
    """How one estimator fared in one run, per step; NEES is nan before the covariance has full rank."""

    position_m: Array
    """(K,) distance from the truth"""
    heading: Array
    """(K,) error, rad"""
    nees3: Array
    """(K,) world coordinates"""
    nees3_invariant: Array
    """(K,)"""
    nees_heading: Array
    """(K,)"""
    step_ms: float
    """mean of predict and update"""


def landmarks() -> Array:
    """(20, 2) on a circle about the centre of the robot's, world frame."""
    angle = 2.0 * math.pi * np.arange(LANDMARKS) / LANDMARKS
    ring = (RADIUS + LANDMARKS_OUTSIDE) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(ring + np.array([0.0, RADIUS]))


def simulate(seed: int, run: int, steps: int = STEPS) -> Evidence:
    """Draw the evidence of the run of that number; the same seed and number give the same evidence."""
    rng = np.random.default_rng([seed, run])
    turn = TURN_RATE * STEP_S * np.arange(1, steps + 1)
    truth = np.stack([RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)), turn], axis=1)
    truth[:, 2] = wrap_angle(truth[:, 2])
    points = landmarks()
    odometry, sightings, way, ways = [], [], STANDSTILL, []
    for row in truth:
        speed = SPEED + SIGMA_SPEED * rng.standard_normal()
        turn_rate = TURN_RATE + SIGMA_TURN_RATE * rng.standard_normal()
        g = arc_jacobian(speed * STEP_S, turn_rate * STEP_S)
        odometry.append(Odometry(rk4(Pose(), speed, turn_rate, STEP_S), g @ ODOMETRY_COV @ g.T))
        way = way.then(odometry[-1])
        ways.append(way.cov)
        z, _, _ = predict_points(Pose.from_array(row), points)
        z_range = np.hypot(z[:, 0], z[:, 1])
        z += SIGMA_POINT * rng.standard_normal(z.shape)
        seen = np.flatnonzero((z_range > NEAREST) & (z_range < FARTHEST)).tolist()
        sightings.append({i: Sighting(Kind.CORNER, z[i], POINT_COV) for i in seen})
    return Evidence(truth, tuple(odometry), tuple(sightings), full_rank_from(np.array(ways)))


def follow(name: str, evidence: Evidence, isam2: ISAM2Config | None = None) -> Track:
    """Feed the evidence to the estimator of that name, which may be a registered one."""
    known = isam2 or ISAM2Config(undo_probability=1.0)  # no match is a guess
    estimator = make_estimator(name, Pose(), np.zeros((3, 3)), known)
    poses, covs, spent_s = [], [], 0.0
    for odometry, sightings in zip(evidence.odometry, evidence.sightings, strict=True):
        began = perf_counter()
        estimator.predict(odometry)
        estimator.update(sightings)
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
