"""Summary of runs: one run in a few lines, and a table of many, with means, intervals and outcomes by group."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.evaluation.effective import EFFECTIVE, band_of_runs, effective_samples

if TYPE_CHECKING:
    import pandas as pd

MEANS = (("ATE m", "ate_rmse_m"), ("NIS/dof", "nis_mean_per_dof"), ("coverage", "coverage"))
"""heading and column of each metric that is shown as a mean with its interval"""

NEES = "pose_nees_world_mean"

_NIS = 0.5, 2.0
"""per degree of freedom; beyond, sigmas are wrong by a factor of 1.4 and more"""


def summary(frame: pd.DataFrame, by: Sequence[str], nees: Sequence[Array | None] = ()) -> list[list[str]]:
    """Summarise a table of runs: a heading, and a row per combination of the values in the columns `by`.

    Means are over the runs that have the metric, with the 95 % interval of Student's t. The mean NEES, 3 for a
    consistent estimator, is followed by the 95 % band of such a mean (`band_of_runs`). `nees` has the NEES along each
    run in the order of the frame, None where it is not known; where that is missing, each run counts as a sample.
    """
    (ate, *rest) = MEANS
    rows = [[*by, "runs", ate[0], "NEES", *(name for name, _ in rest), "outcomes"]]
    numbered = frame.assign(row=range(len(frame)))
    for values, group in numbered.groupby(list(by), sort=True):
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in group["outcome"].value_counts().items())
        cells = [mean_interval(_measured(group, column)) for _, column in MEANS]
        names = [Path(value).stem if name == "scene" else str(value) for name, value in zip(by, values, strict=True)]
        consistency = mean_band(_measured(group, NEES), _effective(group, nees))
        rows.append([*names, str(len(group)), cells[0], consistency, *cells[1:], outcomes])
    return rows


def mean_interval(values: Array) -> str:
    """Mean and half-width of its 95 % interval (Student's t) of three values and more; else the values themselves.

    The interval of two is 13 times as wide as what lies between them: they say next to nothing of their mean.
    """
    if len(values) < 3:
        return ", ".join(f"{value:.3g}" for value in values) + " (two runs say nothing of a mean)" * (len(values) == 2)
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    return f"{values.mean():.3g} ± {half:.2g}"


def mean_band(values: Array, samples: float = 0.0) -> str:
    """Mean NEES of runs, and whether it lies in the 95 % band for their effective number of samples."""
    if len(values) == 0:
        return ""
    low, high = band_of_runs(samples, len(values))
    mean = float(values.mean())
    return f"{mean:.3g} {'in' if low <= mean <= high else 'not in'} {low:.2f}-{high:.2f}"


def _effective(group: Any, nees: Sequence[Array | None]) -> float:
    """Effective number of samples of a group's runs: pooled, and not more than each run has; 0 if it is not known."""
    if not nees or NEES not in group or EFFECTIVE not in group:
        return 0.0
    measured = group[group[NEES].notna()]
    known = [one[np.isfinite(one)] for k in measured["row"] if (one := nees[k]) is not None]
    own = _measured(measured, EFFECTIVE)
    complete = len(known) == len(own) == len(measured)
    return min(effective_samples(known), float(own.sum())) if complete else 0.0


def _measured(group: Any, column: str) -> Array:
    values = group[column].to_numpy(dtype=np.float64) if column in group else np.zeros(0)
    return np.asarray(values[np.isfinite(values)])


_OUTCOMES = {
    "explored": "the robot saw all that it could",
    "explored in part": "some places are left unseen",
    "goal reached": "the robot reached its goal",
    "tour ended": "the robot drove its tour",
    "log ended": "the log was processed to its end",
    "interrupted": "the run was interrupted",
    "collided": "the robot hit a wall",
    "lost": "the robot was lost",
    "stuck": "the robot was stuck",
    "goal unreachable": "no path led to the goal",
    "out of time": "the time limit ended the run",
}


def run_summary(metrics: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a run's summary, label and text, from its metrics.

    A run without truth has a line about its scans. The steps of a run are correlated: its mean NEES is judged by the
    95 % band for its effective number of samples, and with fewer than 30 by that of a single sample.
    """
    parts = {
        "outcome": "; ".join(_outcome(metrics)),
        "map": str(metrics.get("verdict", "")),
        "scans": "" if "ate_rmse_m" in metrics else "; ".join(_scans(metrics)),
        "driven": ", ".join(_driven(metrics)),
        "accuracy": "; ".join(_accuracy(metrics)) or _unmeasured(metrics),
        "consistency": _consistency(metrics),
        "speed": "; ".join(_speed(metrics)),
    }
    return {label: text for label, text in parts.items() if text}


def _outcome(metrics: Mapping[str, Any]) -> Iterator[str]:
    outcome = str(metrics.get("outcome", "unknown"))
    yield f"{outcome}: {_OUTCOMES[outcome]}" if outcome in _OUTCOMES else outcome
    if "coverage" in metrics and outcome.startswith("explored"):
        yield f"coverage {100.0 * metrics['coverage']:.4g} %"
    if "goal_error_m" in metrics and outcome == "goal reached":
        yield f"it stands {_length(metrics['goal_error_m'])} from it"


def _scans(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "scans" in metrics:
        yield f"{metrics['scans']:,} used, {metrics['keyframes']:,} of them as keyframes"
    if "largest_gap_s" in metrics:
        yield f"largest gap {metrics['largest_gap_s']:.3g} s"


def _driven(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "path_length_m" in metrics:
        yield f"{metrics['path_length_m']:,.1f} m in {metrics['sim_time_s']:,.0f} s"
    if "area_seen_m2" in metrics:
        yield f"{metrics['area_seen_m2']:,.0f} m² seen"
    if "loop_closures_found" in metrics:
        yield f"{metrics['loop_closures_found']:,} loop closures"


def _accuracy(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "ate_rmse_m" in metrics:
        yield f"position error {_length(metrics['ate_rmse_m'])} RMS"
        if "dead_reckoning_ate_rmse_m" in metrics:
            yield f"odometry alone {_length(metrics['dead_reckoning_ate_rmse_m'])}"
    if "relations_trans_m_mean" in metrics:
        mean, turn = _length(metrics["relations_trans_m_mean"]), metrics["relations_rot_deg_mean"]
        yield f"error against the relations {mean} and {turn:.2g}° on average"


def _unmeasured(metrics: Mapping[str, Any]) -> str:
    """What is said of the accuracy where nothing measures it."""
    if "map_wrong_probability" in metrics:
        return f"no truth; the map is wrong with probability {metrics['map_wrong_probability']:.2g}"
    return "not measured: no truth, no relations"


def _consistency(metrics: Mapping[str, Any]) -> str:
    if "pose_nees_world_mean" in metrics:
        nees = metrics["pose_nees_world_mean"]
        low, high = band_of_runs(metrics.get(EFFECTIVE, 1.0))
        verdict, where = ("consistent", "within") if low <= nees <= high else ("overconfident", "above")
        if nees < low:
            verdict, where = "cautious", "below"
        return f"{verdict}: NEES {nees:.2g}, {where} the {low:.1f} to {high:.1f} of a consistent run"
    if (nis := metrics.get("nis_mean_per_dof")) is not None:
        said = f"no truth; NIS {nis:.2f} per degree of freedom, 1 is consistent"
        if _NIS[0] <= nis <= _NIS[1]:
            return said
        size = "larger" if nis < _NIS[0] else "smaller"
        return f"{said}: the assumed noise is {size} than the robot's; assumed.laser and assumed.motion state it"
    return "not measured: no truth"


def _speed(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "realtime_factor" in metrics:
        yield f"{_two_digits(metrics['realtime_factor'])} times real time"
    if "scan_ms_p50" in metrics:
        median, high = (_two_digits(metrics[f"scan_ms_{name}"]) for name in ("p50", "p99"))
        yield f"{median} ms a keyframe, {high} ms at the 99th percentile"


def _two_digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 10.0 else f"{value:.2g}"


def _length(metres: float) -> str:
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{100.0 * metres:.1f} cm" if metres >= 0.01 else f"{1e3 * metres:.1f} mm"
