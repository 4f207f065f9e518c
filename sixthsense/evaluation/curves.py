"""Errors of a run along its way: at each keyframe, with the time and the distance driven until then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.evaluation import metrics
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate

Over = Literal["time", "distance"]
"""what a curve is drawn over"""


@dataclass(frozen=True, slots=True)
class Curves:
    """Errors of the causal estimate at a run's keyframes."""

    time_s: Array
    """(K,) since the first scan"""
    distance_m: Array
    """(K,) length of the true path since then"""
    position_m: Array
    """(K,) magnitude of the position's error"""
    heading_rad: Array
    """(K,) magnitude of the heading's error"""
    nees: Array
    """(K,) of the pose, world coordinates; NaN before the covariance has full rank"""

    def over(self, axis: Over) -> Array:
        """(K,) time or distance, ascending."""
        return self.time_s if axis == "time" else self.distance_m


def curves(trace: Trace) -> Curves | None:
    """The errors along a run; None without truth at its keyframes."""
    if not trace.key_truths:
        return None
    poses, covs = key_poses(trace.key_estimates)
    error = poses - np.array(trace.key_truths)
    first = metrics.full_rank_from(covs)
    nees = np.concatenate([np.full(first, np.nan), metrics.nees_world(error[first:], covs[first:])])
    position, heading = np.hypot(error[:, 0], error[:, 1]), np.abs(wrap_angle(error[:, 2]))
    return Curves(key_times(trace), key_distances(trace), position, heading, nees)


def key_poses(estimates: Sequence[Estimate]) -> tuple[Array, Array]:
    """(K, 3) poses of estimates and (K, 3, 3) their covariances, world frame."""
    poses = np.array([estimate.pose.array() for estimate in estimates]).reshape(-1, 3)
    return poses, np.array([estimate.pose_cov for estimate in estimates]).reshape(-1, 3, 3)


def defined_poses(estimates: Sequence[Estimate], truths: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Poses (N, 3), the truth and the covariances (N, 3, 3) from the first of full rank on, as a NEES needs them."""
    poses, covs = key_poses(estimates)
    first = metrics.full_rank_from(covs)
    return poses[first:], np.array(truths).reshape(-1, 3)[first:], covs[first:]


def key_places(trace: Trace, over: Over) -> Array:
    """(K,) where the keyframes lie on an axis of time or distance."""
    return key_times(trace) if over == "time" else key_distances(trace)


def key_times(trace: Trace) -> Array:
    """(K,) seconds from the first scan to each keyframe."""
    return 1e-9 * (np.array(trace.key_stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64)


def key_distances(trace: Trace) -> Array:
    """(K,) metres of the true path, or of the odometry without truth, from the first scan to each keyframe."""
    return np.asarray(np.interp(trace.key_stamps_ns, trace.stamps_ns, _scan_distances(trace)))


def scan_places(trace: Trace, over: Over) -> Array:
    """(S,) where the scans lie on an axis of time or distance."""
    if over == "distance":
        return _scan_distances(trace)
    return 1e-9 * (np.array(trace.stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64)


def _scan_distances(trace: Trace) -> Array:
    path = np.array(trace.truths or trace.odometry).reshape(-1, 3)
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    steps[[scan - 1 for scan in trace.carried_scans()]] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])
