"""Presets: named sets of values, each a nested table over the defaults."""

from __future__ import annotations

import math
from typing import Any, Unpack

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.fields import Fields
from sixthsense.config.section import merge, shown
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
        "robot": {"speed": 0.1, "turn_rate": 0.5, "control_period_s": 1 / 60},
        "laser": {"beams": 180, "max_range": 5.0, "period_ticks": 10},
        "world": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "assumed": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "keyframes": {"distance_m": 0.0, "turn_rad": 0.0},
        "features": {
            "landmarks": "corners",
            "partition": {"method": "fixed", "epsilon_m": 1.0},  # rectangle and apartment; the block had 2 m
            "lines": {"ransac_threshold_m": 0.04, "ransac_iterations": 1000, "min_points": 8, "cut_false_alarm": 0.0},
        },
        # The report has no other rules than its two thresholds.
        "association": {"match_gate": 20.0, "match_odds": 0.0, "new_gate": 200.0, "new_separation_m": 0.0},
        "grid": {"cell_m": 0.04},
        "follow": {"heading_slack_rad": 0.01, "distance_slack_m": 0.01},
        "max_time": 1800.0,
    },
    # Any real robot with a laser: what its log does not say, one set for all. The wheels are uncalibrated, so their
    # noise contains the systematic errors: roots of mean squares of odometry over 0.15 to 0.8 m and 0.3 to 0.8 rad are
    # 0.049, 0.060 and 0.070 rad/sqrt(m), 0.029 and 0.031 m/sqrt(m), 0.047 and 0.074 rad/sqrt(rad) for the robots of
    # Intel, Freiburg 079 (against hand-checked relations) and MRCLAM (against Vicon). The laser is a SICK LMS 200 by
    # its data sheet: statistical error 5 mm, systematic error 15 mm. Real walls are cluttered, hence the floors, and
    # free ends are less accurate than walls. Half a circle of beams 1 degree apart shows short pieces of walls.
    "log": {
        "estimator": "isam2",
        "front_end": "scan-matching",
        "assumed": {
            "motion": {
                "slip_position_per_sqrt_m": 0.03,
                "slip_position_per_sqrt_rad": 0.03,
                "slip_heading_per_sqrt_m": 0.06,
                "slip_heading_per_sqrt_rad": 0.05,
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
        "association": {"new_separation_m": 0.2, "proposed_by": "scan-matching"},
        "grid": {"no_return_passes": False},
    },
    # UTIAS MRCLAM. What differs between its robots is estimated on line; slip is what is left of a turn or a metre
    # against Vicon. Errors of the camera are correlated over seconds, and ranges have a mean error of up to 0.1 m that
    # some filters do not estimate, so that its sigmas exceed the spread of successive frames. Named landmarks are never
    # culled.
    "mrclam": {
        "calibrate_wheels": True,
        "calibrate_sensor": True,
        "assumed": {
            "motion": {
                "speed": 0.0,
                "turn_rate": 0.0,
                "slip_position_per_sqrt_m": 0.05,
                "slip_position_per_sqrt_rad": 0.03,
                "slip_heading_per_sqrt_m": 0.04,
                "slip_heading_per_sqrt_rad": 0.1,
            },
            # Odometry is what was commanded: the robot obeys later, at the next of its controller's cycles of a quarter
            # of a second, and is slower in curves by up to half its track.
            "wheels": {"latency_sigma_s": 0.2, "jitter_sigma_s": 0.07, "curve_loss_sigma_m_per_rad": 0.1},
            "laser": {"range_m": 0.1, "bearing_rad": 0.012},
        },
        "association": {"cull_below": 0, "known_probability": 0.999999},
        "isam2": {"undo_probability": 1.0},
    },
    # A graph states its own noise and matches, and its stamps of one second per pose are not real time.
    "victoria": {"association": {"cull_below": 0}, "isam2": {"undo_probability": 1.0}},
}  # fmt: skip


def preset(name: str = "default", **changes: Unpack[Fields]) -> Config:
    """The named preset's Config, with the fields in `changes` (nested tables for sections) replaced.

    Raises InputError that lists the known names for any other, or names the field with a wrong value.
    """
    if name not in tuple(PRESETS):  # a file may hold a list there, which is not hashable
        raise InputError("preset", f"found {shown(name)}", ", ".join(PRESETS), nearest(name, PRESETS))
    return merge(merge(Config(preset=name), PRESETS[name]).as_implied(), changes)
