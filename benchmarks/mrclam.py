"""MRCLAM set 6, landmarks named by barcodes: the estimators against Vicon, on all robots, with the preset's defaults.

The position RMSE is per axis, sqrt(mean(ex^2 + ey^2) / 2), of the causal estimate at every record of the log; aligned,
after the final map is turned and moved onto the true landmarks, which takes out how the robot stood at its first sight
of them. NEES (3 if consistent) and NIS per degree of freedom (1) are taken at the steps with an observation, and the
NEES of all robots is pooled over these steps. `as logged` takes wheels and camera for exact.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from harness import Figures, arguments, finish, replay

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array, rotation
from sixthsense.core.landmarks import LandmarkId
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import heading_rmse
from sixthsense.logs.mrclam import read_mrclam, robots, true_landmarks
from sixthsense.record.trace import Trace

ROBOT = 3
ON_LINE = ("ekf-invariant", "isam2")
AS_LOGGED = {"calibrate_wheels": False, "calibrate_sensor": False}
PUBLISHED = (("published, standard filter", 0.111), ("published, invariant filter", 0.103))

COLUMNS = (
    ("per axis m", "position_rmse_per_axis_m", ".3f"),
    ("aligned", "position_rmse_per_axis_aligned_m", ".3f"),
    ("map turned by deg", "map_turn_deg", ".1f"),
    ("map scale", "map_scale", ".3f"),
    ("heading deg", "heading_rmse_deg", ".2f"),
    ("NEES", "nees3", ".2f"),
    ("NIS per dof", "nis_per_dof", ".3f"),
    ("misread", "misread", ".0f"),
    ("step ms", "step_ms", ".2f"),
)
FOUND = (
    ("wheel_forward_scale_error", ".3f"),
    ("wheel_turn_scale_error", ".3f"),
    ("wheel_drift_rad_per_m", ".3f"),
    ("sensor_bearing_scale_error", ".3f"),
    ("sensor_centre_tangent", ".3f"),
)


def per_axis_rmse(estimate: Array, truth: Array) -> float:
    """RMSE of the position along one axis, metres, of (N, 3) poses."""
    return float(np.sqrt(np.mean(np.sum((estimate[:, :2] - truth[:, :2]) ** 2, axis=1)) / 2.0))


def estimator_figures(trace: Trace, landmarks: Mapping[LandmarkId, Array]) -> Figures:
    """Figures of one estimator on one robot, with the true places of landmarks."""
    metrics, truth, estimates = measure(trace), np.array(trace.truths), np.array(trace.estimates)
    figures = {
        "position_rmse_per_axis_m": per_axis_rmse(estimates, truth),
        "heading_rmse_deg": math.degrees(heading_rmse(estimates, truth)),
        "nees3": metrics["pose_nees_world_mean"],
        "steps": float(len(trace.key_estimates)),
        "nis_per_dof": metrics["nis_mean_per_dof"],
        "misread": float(sum(association.discarded for association in trace.associations)),
        "step_ms": float(np.mean([row["predict"] + row["update"] for row in trace.stopwatch.rows])),
    }
    true = [k for k, i in enumerate(trace.final.ids.tolist()) if i in landmarks]
    if len(true) > 1:
        places = np.array([landmarks[i] for i in trace.final.ids[true].tolist()])
        figures |= _alignment(trace.final.landmarks[true], places, estimates, truth)
    return figures | {key: metrics[key] for key, _ in FOUND if key in metrics}


def _alignment(landmarks: Array, places: Array, estimates: Array, truth: Array) -> Figures:
    """How far the map (n, 2) is turned and scaled, and the error of poses (N, 3) after turning and moving it."""
    ours, true = landmarks - landmarks.mean(axis=0), places - places.mean(axis=0)
    turn = math.atan2(float(np.sum(true[:, 0] * ours[:, 1] - true[:, 1] * ours[:, 0])), float(np.sum(true * ours)))
    aligned = (estimates[:, :2] - landmarks.mean(axis=0)) @ rotation(turn) + places.mean(axis=0)
    return {
        "map_turn_deg": math.degrees(turn),
        "map_scale": float(np.sqrt(np.sum(ours**2) / np.sum(true**2))),
        "position_rmse_per_axis_aligned_m": per_axis_rmse(aligned, truth),
    }


def robot_figures(folder: Path, robot: int, config: Config) -> Figures:
    """Figures of a configuration on one robot."""
    log = read_mrclam(folder, config.assumed, robot)
    return estimator_figures(replay(log, config).trace, true_landmarks(folder))


def over_robots(figures: Sequence[Figures]) -> Figures:
    """The means over robots; the NEES is pooled, the turn of the map the root mean square."""
    shared = [key for key in figures[0] if all(key in each for each in figures)]
    means = {key: float(np.mean([each[key] for each in figures])) for key in shared}
    means["nees3"] = float(np.average([each["nees3"] for each in figures], weights=[each["steps"] for each in figures]))
    if "map_turn_deg" in means:
        means["map_turn_deg"] = float(np.sqrt(np.mean([each["map_turn_deg"] ** 2 for each in figures])))
    return means


def rows(measured: Mapping[str, Mapping[int, Figures]]) -> list[list[str]]:
    """The table of errors: a row per estimator and robot, one of all robots, and the published means."""
    lines = [["", "robot", *(head for head, _, _ in COLUMNS)]]
    for name, by_robot in measured.items():
        found = [*((str(robot), each) for robot, each in by_robot.items()), ("all", over_robots([*by_robot.values()]))]
        lines += [[name, robot, *_cells(each, [(key, form) for _, key, form in COLUMNS])] for robot, each in found]
    return lines + [[name, "all", f"{value:.3f}", *[""] * (len(COLUMNS) - 1)] for name, value in PUBLISHED]


def parameter_rows(measured: Mapping[str, Mapping[int, Figures]]) -> list[list[str]]:
    """The table of what was estimated with the pose."""
    lines = [["", "robot", *(key for key, _ in FOUND)]]
    for name, by_robot in measured.items():
        lines += [[name, str(robot), *_cells(each, FOUND)] for robot, each in by_robot.items() if FOUND[0][0] in each]
    return lines


def _cells(figures: Figures, columns: Sequence[tuple[str, str]]) -> list[str]:
    return [format(figures[key], form) if key in figures else "" for key, form in columns]


def main() -> int:
    parser = arguments(__doc__)
    data = os.environ.get("SIXTHSENSE_DATA")
    default = None if data is None else Path(data) / "mrclam6"
    parser.add_argument("--data", type=Path, default=default, metavar="DIR", help="a set ($SIXTHSENSE_DATA/mrclam6)")
    parser.add_argument("--robots", type=int, nargs="+", metavar="N", help="some of its robots (all)")
    parser.add_argument("--estimators", nargs="+", default=ON_LINE, metavar="NAME", help="(ekf-invariant isam2)")
    parser.add_argument("--as-logged", action="store_true", help="also with wheels and camera taken for exact")
    options = parser.parse_args()
    if options.data is None or not options.data.is_dir():
        print("mrclam.py: --data or SIXTHSENSE_DATA/mrclam6 must be the folder of a set of MRCLAM", file=sys.stderr)
        return 2
    configs = {name: preset("mrclam", estimator=name) for name in options.estimators}
    if options.as_logged:
        configs |= {f"{name}, as logged": preset("mrclam", estimator=name, **AS_LOGGED) for name in options.estimators}
    measured: dict[str, dict[int, Figures]] = {}
    for name, config in configs.items():
        chosen = options.robots or robots(options.data)
        measured[name] = {robot: robot_figures(options.data, robot, config) for robot in chosen}
    finish(options, "mrclam_robots", rows(measured), parameter_rows(measured), text=2)
    return 0


if __name__ == "__main__":
    sys.exit(main())
