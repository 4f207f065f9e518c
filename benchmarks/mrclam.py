"""MRCLAM set 6, robot 3, known landmarks: every estimator against Vicon, on the same measurements.

The position RMSE is per axis, sqrt(mean(ex^2 + ey^2) / 2), of the causal estimate at every record of the log. NEES (3
if consistent) and NIS per degree of freedom (1) are taken at the steps with an observation.
"""

from __future__ import annotations

import dataclasses
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from harness import Figures, arguments, finish, replay

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import heading_rmse
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.sources.logs.mrclam import MrclamLog, read_mrclam

ROBOT = 3
PUBLISHED = (("published, standard, mean of 5 robots", 0.111), ("published, invariant, mean of 5 robots", 0.103))

COLUMNS = (
    ("per axis m", "position_rmse_per_axis_m", ".3f"),
    ("at observations", "position_rmse_per_axis_at_observations_m", ".3f"),
    ("smoothed", "position_rmse_per_axis_smoothed_m", ".3f"),
    ("heading deg", "heading_rmse_deg", ".2f"),
    ("NEES", "nees3", ".2f"),
    ("invariant", "nees3_invariant", ".2f"),
    ("NIS per dof", "nis_per_dof", ".3f"),
    ("landmarks m", "landmark_rmse_m", ".3f"),
    ("misread", "misread", ".0f"),
    ("step ms", "step_ms", ".2f"),
)
# The wheels of this robot, a fit to intervals of 10 s against Vicon. No preset knows them.
ON_LINE = ("ekf-invariant", "isam2")
CALIBRATED = {"wheel_scale_error": -0.056, "drift_rad_per_m": -0.058}


def per_axis_rmse(estimate: Array, truth: Array) -> float:
    """RMSE of the position along one axis, metres, of (N, 3) poses."""
    return float(np.sqrt(np.mean(np.sum((estimate[:, :2] - truth[:, :2]) ** 2, axis=1)) / 2.0))


def estimator_figures(trace: Trace, log: MrclamLog) -> Figures:
    """Figures of one estimator."""
    metrics, truth, key_truth = measure(trace), np.array(trace.truths), np.array(trace.key_truths)
    causal = np.array([estimate.pose.array() for estimate in trace.key_estimates])
    figures = {
        "position_rmse_per_axis_m": per_axis_rmse(np.array(trace.estimates), truth),
        "position_rmse_per_axis_at_observations_m": per_axis_rmse(causal, key_truth),
        "position_rmse_per_axis_smoothed_m": per_axis_rmse(trace.trajectory, key_truth),
        "heading_rmse_deg": math.degrees(heading_rmse(np.array(trace.estimates), truth)),
        "nees3": metrics["pose_nees_world_mean"],
        "nees3_invariant": metrics["pose_nees_invariant_mean"],
        "nis_per_dof": metrics["nis_mean_per_dof"],
        "misread": sum(association.discarded for association in trace.associations),
        "step_ms": float(np.mean([row["predict"] + row["update"] for row in trace.stopwatch.rows])),
    }
    true = [k for k, i in enumerate(trace.final.ids.tolist()) if i in log.landmarks]
    if true:
        places = np.array([log.landmarks[i] for i in trace.final.ids[true].tolist()])
        gap = trace.final.landmarks[true] - places
        figures["landmark_rmse_m"] = float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))
    return figures


def log_figures(log: MrclamLog, config: Config, estimators: Sequence[str] = ESTIMATORS) -> Figures:
    """Flat keys such as `ekf_invariant.position_rmse_per_axis_m`; odometry alone is `dead_reckoning`."""
    figures: Figures = {}
    for name in estimators:
        trace = replay(log, dataclasses.replace(config, estimator=name)).trace
        figures |= {f"{name.replace('-', '_')}.{key}": value for key, value in estimator_figures(trace, log).items()}
        odometry, truth = np.array(trace.odometry), np.array(trace.truths)
    figures["dead_reckoning.position_rmse_per_axis_m"] = per_axis_rmse(odometry, truth)
    figures["dead_reckoning.heading_rmse_deg"] = math.degrees(heading_rmse(odometry, truth))
    if "ekf.position_rmse_per_axis_m" in figures:
        for name in estimators:
            key = f"{name.replace('-', '_')}.position_rmse"
            figures[f"{key}_by_ekf"] = figures[f"{key}_per_axis_m"] / figures["ekf.position_rmse_per_axis_m"]
    return figures


def rows(figures: Figures, estimators: Sequence[str] = ESTIMATORS) -> list[list[str]]:
    """The table: a row per estimator, one of odometry, and the published values."""
    lines = [["", *(head for head, _, _ in COLUMNS)]]
    for name in ("dead reckoning", *estimators):
        label = name.replace("-", "_").replace(" ", "_")
        cells = [(figures.get(f"{label}.{key}"), form) for _, key, form in COLUMNS]
        lines.append([name, *("" if value is None else format(value, form) for value, form in cells)])
    lines += [[name, f"{value:.3f}", *[""] * (len(COLUMNS) - 1)] for name, value in PUBLISHED]
    return lines


def main() -> int:
    parser = arguments(__doc__)
    data = os.environ.get("SIXTHSENSE_DATA")
    default = None if data is None else Path(data) / "mrclam6"
    parser.add_argument("--data", type=Path, default=default, metavar="DIR", help="the set ($SIXTHSENSE_DATA/mrclam6)")
    parser.add_argument("--uncalibrated", action="store_true", help="without the wheels' systematic errors")
    parser.add_argument("--on-line", action="store_true", help="the wheels estimated on line, from neutral values")
    options = parser.parse_args()
    if options.data is None or not options.data.is_dir():
        print("mrclam.py: --data or SIXTHSENSE_DATA/mrclam6 must be the folder of set 6 of MRCLAM", file=sys.stderr)
        return 2
    neutral = options.uncalibrated or options.on_line
    config = preset("mrclam", assumed={} if neutral else CALIBRATED, calibrate_wheels=options.on_line)
    estimators = ON_LINE if options.on_line else ESTIMATORS
    log = read_mrclam(options.data, config.assumed, ROBOT)
    finish(options, "mrclam", rows(log_figures(log, config, estimators), estimators))
    return 0


if __name__ == "__main__":
    sys.exit(main())
