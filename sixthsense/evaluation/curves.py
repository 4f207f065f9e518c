"""Errors of a run along its way: at each scan, with the time and the distance driven until then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import Odometry, propagated
from sixthsense.core.source import seconds
from sixthsense.evaluation import metrics
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate

if TYPE_CHECKING:
    import pandas as pd

Over = Literal["time", "distance"]
"""what a curve is drawn over"""
PLACE = {"time": "time_s", "distance": "distance_m"}
"""column of curves with the place on an axis"""
CURVES = ("time_s", "distance_m", "position_m", "heading_rad", "nees")
"""columns of the errors along a run"""


def curves(trace: Trace) -> pd.DataFrame | None:
    """The errors of the causal estimate, a row per scan; None without truth at the scans.

    `time_s` since the first scan; `distance_m`, the true path since then; magnitudes `position_m` and `heading_rad` of
    the error; `nees` of the pose at keyframes, world coordinates, NaN at other scans and before full rank.
    """
    if not trace.truths or not trace.key_truths:
        return None
    import pandas as pd

    error = np.array(trace.estimates) - np.array(trace.truths)
    nees = np.full(len(error), np.nan)
    nees[np.searchsorted(trace.stamps_ns, trace.key_stamps_ns)] = key_nees(trace)
    columns = (
        scan_places(trace, "time"), scan_places(trace, "distance"), np.hypot(error[:, 0], error[:, 1]),
        np.abs(wrap_angle(error[:, 2])), nees,
    )  # fmt: skip
    return pd.DataFrame(dict(zip(CURVES, columns, strict=True)))


def key_errors(trace: Trace) -> tuple[Array, Array]:
    """Errors (N, 3) of the pose at keyframes and their covariances (N, 3, 3), from the first of full rank on."""
    poses, covs = key_poses(trace.key_estimates)
    first = metrics.full_rank_from(covs)
    error = poses[first:] - np.array(trace.key_truths).reshape(-1, 3)[first:]
    error[:, 2] = wrap_angle(error[:, 2])
    return error, covs[first:]


def key_nees(trace: Trace) -> Array:
    """(K,) NEES of the pose at keyframes, world coordinates; NaN before the covariance has full rank."""
    nees = metrics.squares(*key_errors(trace))
    return np.concatenate([np.full(len(trace.key_estimates) - len(nees), np.nan), nees])


def scan_covariances(trace: Trace) -> Array:
    """(S, 3, 3) covariance of the causal estimate at each scan, world frame: its keyframe's, and the motion since."""
    found = np.zeros((len(trace.estimates), 3, 3))
    if not trace.key_estimates:
        return found
    for cov, k, pose, since in zip(found, trace.last_key, trace.estimates, trace.since_covs, strict=True):
        if k >= 0:
            key = trace.key_estimates[k]
            motion = key.pose.inverse() @ Pose.from_array(pose)
            cov[:] = propagated(key.pose, key.pose_cov, Odometry(motion, since))
    return found


def key_poses(estimates: Sequence[Estimate]) -> tuple[Array, Array]:
    """(K, 3) poses of estimates and (K, 3, 3) their covariances, world frame."""
    poses = np.array([estimate.pose.array() for estimate in estimates]).reshape(-1, 3)
    return poses, np.array([estimate.pose_cov for estimate in estimates]).reshape(-1, 3, 3)


def key_places(trace: Trace, over: Over) -> Array:
    """(K,) where the keyframes lie on an axis of time or distance."""
    return np.asarray(np.interp(trace.key_stamps_ns, trace.stamps_ns, scan_places(trace, over)))


def scan_places(trace: Trace, over: Over) -> Array:
    """(S,) seconds since the first scan, or metres of the true path since then, of the odometry without truth."""
    if over == "time":
        return seconds((np.array(trace.stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64))
    path = np.array(trace.truths or trace.odometry).reshape(-1, 3)
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    steps[[scan - 1 for scan in trace.carried_scans()]] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])
