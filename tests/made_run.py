"""A run whose record is made by hand, so that a few plain lines compute what is measured of it.

No pose, mount, origin or angle in it is zero, no shape is a square, and all covariances have correlations.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from predicted import ideal_wall
from scanned import box

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.logs.log import Relations
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.record.trace import Stopwatch, Trace
from sixthsense.simulation.scene import Scene
from sixthsense.slam.association.records import Association, Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import LoopClosureCounts

SCANS, FIRST_KEY, EVERY = 66, 2, 3
UNDEFINED = 3
"""keyframes at the beginning whose covariance has no full rank"""
CARRIED = 7
"""keyframe before which the robot was carried"""
WALLS = np.concatenate([box(-1.3, 0.4, 7.5, 4.5), [[[3.1, 0.4], [3.1, 1.6]]]])
CORNERS = np.array([[-1.3, 0.4], [6.2, 0.4], [6.2, 4.9], [-1.3, 4.9], [3.1, 0.4], [3.1, 1.6]])
"""of the walls, their ends included"""
LASER = {"beams": 340, "fov": 3.9, "max_range": 1.7, "mount": (0.17, -0.11, 0.6)}


def covariances(rng: np.random.Generator, count: int, sigmas: Array) -> Array:
    """(count, d, d) of full rank, with correlations of all signs."""
    root = np.eye(len(sigmas)) + rng.uniform(-0.6, 0.6, (count, len(sigmas), len(sigmas)))
    return np.einsum("i,kij,klj,l->kil", sigmas, root, root, sigmas)


def of_wall(pose: Array, start: Array, end: Array) -> Observation:
    """An observation of the wall between two places."""
    return ideal_wall(Pose.from_array(pose), np.array([start, end]), np.diag([3e-4, 2e-4]))


@functools.cache
def made_run() -> Trace:
    """The record; not to be changed, `dataclasses.replace` makes another one."""
    rng = np.random.default_rng(11)
    angle = 0.41 + 0.12 * np.arange(SCANS)
    truths = np.column_stack([2.4 + 2.6 * np.cos(angle), 3.2 + 1.1 * np.sin(angle), angle])
    truths[:, 2] = wrap_angle(np.arctan2(1.1 * np.cos(angle), -2.6 * np.sin(angle)))
    estimates = truths + rng.normal(0.01, 0.03, truths.shape)
    estimates[:, 2] = wrap_angle(estimates[:, 2])
    odometry = truths + np.arange(SCANS)[:, None] * [0.011, -0.007, 0.003]
    steps_ns = rng.integers(90_000_001, 140_000_000, SCANS)
    steps_ns[20] = 612_345_678
    stamps = 976_052_857_337_284_000 + np.cumsum(steps_ns) // 1000 * 1000
    keys = np.arange(FIRST_KEY, SCANS, EVERY)
    last_key = np.maximum(np.arange(SCANS) - FIRST_KEY, 0) // EVERY
    covs = covariances(rng, len(keys), np.array([0.04, 0.02, 0.03]))
    covs[:UNDEFINED] = np.array([np.zeros((3, 3)), np.diag([0.0, 0.0, 4e-4]), np.outer([3, 2, 4], [3, 2, 4])])
    lasting = np.sin(0.35 * np.arange(len(keys)))[:, None] * [0.05, -0.03, 0.04]
    updated = truths[keys] + lasting + rng.normal(0.0, 0.01, (len(keys), 3))
    predicted = truths[keys] + rng.normal(0.0, 0.05, (len(keys), 3))
    motions = [Odometry(Pose(0.3, 0.02, 0.1), np.diag([1e-4, 2e-4, 3e-4]) * (1e6 if k == CARRIED else 1.0)) for k in
               range(len(keys))]  # fmt: skip
    trace = Trace(
        preset(task="explore", laser=LASER, explore={"return_home": True}, seed=5),
        Scene("made", WALLS, Pose(*truths[0]), 0.21, (4.6, 2.2), (), (-1.3, 0.4, 6.2, 4.9)),
        0.21, stamps.tolist(), (1e-9 * stamps).tolist(), list(estimates), list(odometry), list(truths),
        last_key=last_key.tolist(), since_key=list(rng.uniform(-0.3, 0.5, (SCANS, 3))), key_odometry=motions,
        key_stamps_ns=stamps[keys].tolist(), key_truths=list(truths[keys]), touches=(2, 5), outcome="explored in part",
        key_estimates=[Estimate.of_pose(Pose(*p), c) for p, c in zip(updated, covs, strict=True)],
        key_predicted=[Estimate.of_pose(Pose(*p), 2.5 * c) for p, c in zip(predicted, covs, strict=True)],
        path_length_m=13.7, wall_time_s=2.31, plans=[truths[:4, :2]] * 3, plans_below_margin=4, plans_by_astar=6,
        guard_stops=7, left=[UnseenPlace(5.2, 1.3, 0.7, "gave up"), UnseenPlace(5.4, 0.9, 1.6, "unreachable")],
        trajectory=truths[keys] + rng.normal(0.0, 0.02, (len(keys), 3)), culled=8, walls_merged=9, name="made",
        loop_closures=LoopClosureCounts(14, 19, 12), last_position=np.array([4.3, 3.9]),
        wheels=rng.uniform(0.01, 0.02, (2, 3)), sensor=rng.uniform(0.01, 0.02, (2, 2)),
        since_covs=list(covariances(rng, SCANS, np.array([0.01, 0.03, 0.02]))),
    )  # fmt: skip
    trace.associations = [Association({}, 2 + k % 3, 1.3 * k + 0.4, 2 * (k % 4), k % 2) for k in range(len(keys))]
    trace.stopwatch = Stopwatch()
    trace.stopwatch.rows = [{"sense": 9.0, "extract": 1.0 + 0.1 * k**1.5, "update": 0.3 * k} for k in range(len(keys))]
    trace.stopwatch.totals |= {"sense": 310.0, "extract": 47.0, "update": 81.0}
    _add_landmarks(trace, rng)
    _add_relations(trace, rng)
    return trace


def _add_landmarks(trace: Trace, rng: np.random.Generator) -> None:
    """Three walls and four points in mixed order; two walls and an end are observed."""
    tip = trace.key_truths[11]
    z = Pose.from_array(tip).inverse() @ np.array([[3.08, 1.62]])
    known = {
        2: {12: of_wall(trace.key_truths[2], np.array([2.3, 4.9]), np.array([3.4, 4.9]))},
        11: {13: Observation(Kind.END, z[0], np.diag([1e-4, 2e-4]))},
        15: {15: of_wall(trace.key_truths[15], np.array([6.2, 2.7]), np.array([6.2, 3.6]))},
    }
    for k, observations in known.items():
        old = trace.associations[k]
        trace.associations[k] = Association(observations, old.discarded, old.nis, old.dof, old.fused)
    ids, walls = np.array([12, 14, 13, 15, 16, 18, 19]), np.array([1, 1, 0, 1, 0, 0, 0], dtype=bool)
    means = [[-1.566, -4.92], [2.9, 0.3], [3.14, 1.57], [-3.139, -6.21], [-1.0, 0.65], [6.4, 5.05], [-2.1, 5.2]]
    trace.final = Estimate(trace.key_estimates[-1].pose, trace.key_estimates[-1].pose_cov, ids, np.array(means), walls)
    trace.joint_cov = covariances(rng, 1, np.array([0.04, 0.02, 0.03, *rng.uniform(0.02, 0.04, 14)]))[0]
    trace.records = {
        i: Record(Kind.WALL if wall else Kind.END, 3 + i, 1, 7, extent=rng.uniform(1.0, 4.0, (2, 2)))
        for i, wall in zip(ids.tolist(), walls, strict=True)
    }


def _add_relations(trace: Trace, rng: np.random.Generator) -> None:
    """Nine relations of scans, with errors; of a tenth one stamp is after the end."""
    stamps, poses = np.array(trace.log_stamps_s), trace.scan_poses()
    pairs = rng.integers(0, SCANS, (10, 2))
    found = []
    for first, second in pairs:
        off = Pose(*rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.3, 0.3))
        found.append((Pose(*poses[first]).inverse() @ Pose(*poses[second]) @ off).array())
    named = stamps[pairs]
    named[4, 1] += 1000.0
    trace.relations = Relations(named, np.array(found))


def matrix(pose: Array) -> Array:
    """(3, 3) of a pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])
