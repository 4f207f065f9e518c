"""Scan matching: logs against their relations, damaged, by scans alone; earlier maps."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from damaged_logs import damaged
from runs import Figures, Setting, data_path, replay_figures

import sixthsense as ss
from sixthsense.config import preset
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import between, compose
from sixthsense.logs.log import Log, Relations, matched
from sixthsense.logs.replay_input import ReplayInput, of_log, open_recorded
from sixthsense.slam.slam import Slam

FILES = {
    "intel": "intel/intel.clf.bz2", "fr079": "fr079/fr079.clf.bz2", "aces": "aces/aces.clf.bz2",
    "clinic": "clinic/clinic.bag",
}  # fmt: skip
RELATION_SIGMAS = np.diag([0.017, 0.017, 0.008]) ** 2
"""of the relations themselves, m and rad: of largest likelihood on Intel and Freiburg 079"""
SHARES = (0.5, 0.9, 0.95)
NEAR_S = 5.0
"""between the scans of the relations whose stated sigma is shown"""


def opened(name: str, **fields: bool) -> tuple[ReplayInput, Log, Relations]:
    """A log with its relations and the configuration of its replay."""
    found = open_recorded(data_path(FILES[name]), preset("log", **fields), data_path(f"{name}/{name}.relations"))
    assert found.relations is not None
    return found, found.log, found.relations


def relations(setting: Setting, seed: int) -> Figures:
    """A log as the plain command replays it, or by scans alone."""
    found, log, known = opened(setting[0], no_odometry=setting[-1] == "scans alone")
    return replay_figures(log, found.config, known)


def damage(setting: Setting, seed: int) -> Figures:
    """A log whose scans are damaged, drawn by the seed."""
    _, log, known = opened(setting[0])
    log, known = damaged(setting[1], log, known, seed)
    return replay_figures(log, of_log(preset("log"), log), known)


def stated_covariances(setting: Setting, seed: int) -> Figures:
    """Relations of a log against the covariances that the smoother states between keyframes.

    The motion between a scan and its keyframe is taken as exact.
    """
    found, log, known = opened(setting[0])
    stamps, keys, key = [], [], 0
    with Slam(found.config, log.start, draws_map=False) as slam:
        for tick in log.ticks:
            step = slam.take(tick)
            key = key if step.keyframe is None else step.keyframe.index
            if tick.scan is not None:
                stamps.append(tick.log_stamp_s)
                keys.append(key)
        result = slam.finish()
        rows = matched(stamps, known.stamps)
        stated = slam.relative_covariances(np.array(keys)[rows])
    assert result.since_key is not None
    poses = compose(result.trajectory[keys], result.since_key)
    errors = off(known.poses, poses[rows])
    covs = stated + RELATION_SIGMAS
    squared = np.einsum("ri,rij,rj->r", errors, np.linalg.inv(covs), errors)
    near = np.abs(np.diff(np.array(stamps)[rows]))[:, 0] <= NEAR_S
    sigma = np.sqrt(np.median(np.diagonal(stated[near], axis1=1, axis2=2), axis=0))
    return {
        "relations": len(errors), "squared": squared.mean() / 3.0, "stated_m": np.hypot(*sigma[:2]) / np.sqrt(2.0),
        **{f"within_{100 * share:.0f}": (squared <= chi_square_quantile(share, 3)).mean() for share in SHARES},
    }  # fmt: skip


def off(known: Array, ends: Array) -> Array:
    """(R, 3) errors of the motions between poses (R, 2, 3), in the frames of the second ones."""
    return between(known, between(ends[:, 0], ends[:, 1]))


def lost(setting: Setting, seed: int) -> Figures:
    """A robot that begins anywhere in the map of an earlier run of a scene, and is not told where."""
    with tempfile.TemporaryDirectory() as folder:
        earlier = Path(folder) / "earlier"
        fields = {"task": "tour", "max_time": 120.0, "progress": False}
        ss.run(setting[0], seed=seed + 100, out=earlier, **fields)
        made = ss.run(setting[0], seed=seed, prior_map=earlier, lost=True, **fields)
    error = Pose.from_array(made.trace.truths[-1]).inverse() @ Pose.from_array(made.trace.estimates[-1])
    return {"outcome": made.metrics["outcome"], "error_m": float(np.hypot(error.x, error.y))}


def merged(setting: Setting, seed: int) -> Figures:
    """Two runs of a scene that are merged: the error of all poses in the frame of the first."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / part for part in ("first", "second")]
        for k, folder in enumerate(folders):
            ss.run(setting[0], seed=seed + 100 * k, task="tour", max_time=120.0, out=folder, progress=False)
        made = ss.merge_runs(*folders, progress=False)
    return {"outcome": made.metrics["outcome"], "ate_m": made.metrics.get("ate_rmse_m")}
