"""Shared by the measurements: runs and replays without a progress bar, and where the data are."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from sixthsense.config import Config
from sixthsense.evaluation.metrics import relations_error
from sixthsense.figures.run import Run
from sixthsense.logs.log import Log, Relations
from sixthsense.logs.replay_input import ReplayInput
from sixthsense.running.runs import QUIET, replay_log, simulate
from sixthsense.simulation.mission import mission_of
from sixthsense.simulation.scene import Scene

METRICS = {
    "outcome": "outcome", "coverage": "coverage", "collisions": "collisions", "by_robot": "touches_by_robot",
    "by_walkers": "touches_by_walkers", "nees": "pose_nees_world_mean", "nis": "nis_mean_per_dof",
    "landmark_nees": "landmark_nees_mean", "discarded_share": "discarded_share", "ate_m": "ate_rmse_m",
    "home_m": "home_error_m", "travel_m": "path_length_m", "sim_s": "sim_time_s",
}  # fmt: skip
"""figure by figure, the metric that it is"""
Figures = dict[str, Any]
"""numbers by name, and of a run its `outcome`"""
Setting = tuple[str, ...]


def data_path(name: str) -> Path:
    """A file of the real data; one that does not exist where SIXTHSENSE_DATA is not set."""
    return Path(os.environ.get("SIXTHSENSE_DATA", "/nonexistent")) / name


def run(config: Config, scene: Scene | None = None) -> Run:
    """Simulate a configuration, in a scene if it is given, with the stages of the loop timed by the processor.

    So other work of the machine hardly counts.
    """
    with mock.patch.object(time, "perf_counter", time.thread_time):  # what the stopwatch of the stages reads
        return simulate(*mission_of(config, scene), watch=QUIET)


def replay(log: Log, config: Config, relations: Relations | None = None) -> Run:
    """Replay an open log."""
    return replay_log(ReplayInput("log", log, config, relations, {}, ()))


def replay_figures(log: Log, config: Config, relations: Relations) -> Figures:
    """Outcome of a replay, errors against relations whose scans the log has, and processor time without reading."""
    began = time.process_time()
    trace = replay(log, config, relations).trace
    spent_s = time.process_time() - began
    errors_m, angles = relations_error(
        np.array(trace.log_stamps_s), trace.scan_poses(), relations.stamps, relations.poses
    )
    return {
        "outcome": trace.outcome, "trans_m_mean": errors_m.mean(), "trans_m_std": errors_m.std(),
        "trans_m_max": errors_m.max(), "rot_deg_mean": np.degrees(angles).mean(),
        "beyond_share": (errors_m > 0.5).mean(), "processor_s": spent_s,
        "times_real_time": log.duration_s / spent_s,
    }  # fmt: skip


def chosen(metrics: Mapping[str, Any]) -> Figures:
    """The figures that are metrics, those that there are."""
    return {name: metrics[key] for name, key in METRICS.items() if key in metrics}
