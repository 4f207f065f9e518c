"""Errors of a run along its way: at each scan, with the time and the distance driven until then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.se2 import composed_covariance, relative, triple
from sixthsense.core.source import seconds
from sixthsense.evaluation import metrics
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate

Over = Literal["time", "distance"]
"""what a curve is drawn over"""


@dataclass(frozen=True, slots=True)
class Curves:
    """Errors of the causal estimate at a run's scans, which are those that its metrics count."""

    time_s: Array
    """(S,) since the first scan"""
    distance_m: Array
    """(S,) length of the true path since then"""
    position_m: Array
    """(S,) magnitude of the position's error"""
    heading_rad: Array
    """(S,) magnitude of the heading's error"""
    nees: Array
    """(S,) of the pose at keyframes, world coordinates; NaN at other scans, and before the covariance has full rank"""

    def over(self, axis: Over) -> Array:
        """(S,) time or distance, ascending."""
        return self.time_s if axis == "time" else self.distance_m


def curves(trace: Trace) -> Curves | None:
    """The errors along a run; None without truth at its scans."""
    if not trace.truths or not trace.key_truths:
        return None
    error = np.array(trace.estimates) - np.array(trace.truths)
    nees = np.full(len(error), np.nan)
    nees[np.searchsorted(trace.stamps_ns, trace.key_stamps_ns)] = key_nees(trace)
    position, heading = np.hypot(error[:, 0], error[:, 1]), np.abs(wrap_angle(error[:, 2]))
    return Curves(scan_places(trace, "time"), scan_places(trace, "distance"), position, heading, nees)


def key_nees(trace: Trace) -> Array:
    """(K,) NEES of the pose at keyframes, world coordinates; NaN before the covariance has full rank."""
    poses, covs = key_poses(trace.key_estimates)
    error, first = poses - np.array(trace.key_truths), metrics.full_rank_from(covs)
    return np.concatenate([np.full(first, np.nan), metrics.nees_world(error[first:], covs[first:])])


def scan_covariances(trace: Trace) -> Array:
    """(S, 3, 3) covariance of the causal estimate at each scan, world frame: its keyframe's, and the motion since."""
    found = np.zeros((len(trace.estimates), 3, 3))
    if not trace.key_estimates:
        return found
    for cov, k, pose, since in zip(found, trace.last_key, trace.estimates, trace.since_covs, strict=True):
        if k >= 0:
            key = trace.key_estimates[k]
            x, y, _ = relative(key.pose.triple(), triple(pose))
            cov[:] = composed_covariance(key.pose_cov, since, key.pose.theta, x, y)
    return found


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
    return seconds((np.array(trace.key_stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64))


def key_distances(trace: Trace) -> Array:
    """(K,) metres of the true path, or of the odometry without truth, from the first scan to each keyframe."""
    return np.asarray(np.interp(trace.key_stamps_ns, trace.stamps_ns, _scan_distances(trace)))


def scan_places(trace: Trace, over: Over) -> Array:
    """(S,) where the scans lie on an axis of time or distance."""
    if over == "distance":
        return _scan_distances(trace)
    return seconds((np.array(trace.stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64))


def _scan_distances(trace: Trace) -> Array:
    path = np.array(trace.truths or trace.odometry).reshape(-1, 3)
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    steps[[scan - 1 for scan in trace.carried_scans()]] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])
