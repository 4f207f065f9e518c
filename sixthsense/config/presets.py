"""Presets: named sets of values, each a nested table over the defaults."""

from __future__ import annotations

import math
from typing import Any

from sixthsense.config.section import ConfigError, merge, shown
from sixthsense.config.tree import Config

_REPORT_MOTION = {
    "distribution": "uniform", "speed": 0.1, "turn_rate": 0.1, "slip_position_per_sqrt_m": 0.0,
    "slip_position_per_sqrt_rad": 0.0, "slip_heading_per_sqrt_m": 0.0, "slip_heading_per_sqrt_rad": 0.0,
}  # fmt: skip
_REPORT_LASER = {"distribution": "uniform", "range_m": 0.01, "bearing_rad": 0.05 * 2 * math.pi / 180}
_SILENT_MOTION = {**_REPORT_MOTION, "distribution": "gaussian", "speed": 0.0, "turn_rate": 0.0}

PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    # Systematic errors unknown to the estimators: a scale error of both wheels' radii, and unequal radii.
    "worn": {"world": {"wheel_scale_error": 0.02, "drift_rad_per_m": math.radians(0.5)}},
    "noiseless": {"world": {"motion": _SILENT_MOTION, "laser": {"range_m": 0.0, "bearing_rad": 0.0}}},
    # 181 beams over [-pi, pi] whose last repeats the first: 180 around a closed circle.
    "report": {
        "estimator": "ekf",
        "robot": {"speed": 0.1, "turn_rate": 0.5, "control_period_s": 1 / 60, "integration_step_s": 0.01},
        "laser": {"beams": 180, "max_range": 5.0, "period_ticks": 10},
        "world": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "assumed": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "keyscans": {"distance_m": 0.0, "turn_rad": 0.0},
        "features": {
            "landmarks": "corners",
            "partition": {"method": "fixed", "epsilon_m": 1.0},  # rectangle and apartment; the block had 2 m
            "lines": {"ransac_threshold_m": 0.04, "ransac_iterations": 1000, "min_points": 8},
        },
        # The report has no other rules than its two thresholds.
        "association": {"method": "report", "pre_gate_m": 5.0, "new_separation_m": 0.0},
        "grid": {"cell_m": 0.04},
        "follow": {"heading_slack_rad": 0.01, "distance_slack_m": 0.01},
        "max_time": 1800.0,
    },
    # The Intel Research Lab's robot. The systematic errors of its wheels come from a regression of the filter's motion
    # on the odometry's, iterated to convergence, without the relations. Slip and thresholds were tuned on the error of
    # the relations with corners, so it is no independent test of them. Real walls are cluttered, hence the floors, and
    # free ends are less accurate than walls. Half a circle of beams 1 degree apart shows short pieces of walls.
    "intel": {
        "laser": {"beams": 180, "fov": math.radians(179.0), "max_range": 50.0},
        "assumed": {
            "wheel_scale_error": -0.02,
            "drift_rad_per_m": 0.0595,
            "motion": {
                "slip_position_per_sqrt_m": 0.02,
                "slip_heading_per_sqrt_m": 0.035,
                "slip_heading_per_sqrt_rad": 0.03,
            },
            "laser": {"range_m": 0.015},
            "landmark_floor_m": 0.02,
            "wall_floor_rad": 0.006,
        },
        "features": {
            "landmarks": "walls",
            "split": {"epsilon_m": 0.08},
            "lines": {"min_points": 3},
            "points": {"min_points": 3, "max_sigma_m": 0.25},
        },
        "association": {"pre_gate_m": 3.0, "new_separation_m": 0.2},
        "grid": {"no_return_passes": False},
        "max_time": 1e6,
    },
    # Set 6, robot 3 of UTIAS MRCLAM, all measured against Vicon. The wheels: a fit to intervals of 10 s; the noise is
    # large because errors of records 10 ms apart are correlated over seconds. The camera: root mean squares of depth
    # and bearing, including the depth's mean error of 0.1 m. Named landmarks are never culled.
    "mrclam": {
        "assumed": {
            "wheel_scale_error": -0.056,
            "drift_rad_per_m": -0.058,
            "motion": {
                "speed": 1.9,
                "turn_rate": 0.095,
                "slip_position_per_sqrt_m": 0.0025,
                "slip_position_per_sqrt_rad": 0.0083,
                "slip_heading_per_sqrt_m": 0.037,
                "slip_heading_per_sqrt_rad": 0.095,
            },
            "laser": {"range_m": 0.1, "bearing_rad": 0.01},
        },
        "association": {"culling": False, "known_probability": 0.999999},
        "isam2": {"undo_probability": 1.0},
        "max_time": 1e6,
    },
    # A graph states its own noise and matches, and its stamps of one second per pose are not real time.
    "victoria": {"association": {"culling": False}, "isam2": {"undo_probability": 1.0}, "max_time": 1e6},
}  # fmt: skip


def preset(name: str = "default", **changes: Any) -> Config:
    """The named preset's Config, with the fields in `changes` (nested tables for sections) replaced.

    Raises ConfigError that lists the known names for any other, or names the field with a wrong value.
    """
    if name not in tuple(PRESETS):  # a file may hold a list there, which is not hashable
        raise ConfigError(f"preset: found {shown(name)}, allowed: {', '.join(PRESETS)}")
    return merge(merge(Config(preset=name), PRESETS[name]), changes)
