"""Summary of runs: one run in a few lines, and a table of many, with means, intervals and outcomes by group."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.evaluation.consistency import Consistency, short
from sixthsense.evaluation.effective import effective_samples

if TYPE_CHECKING:
    import pandas as pd

NEES, EFFECTIVE = "pose_nees_world_mean", "pose_nees_effective_samples"
_NIS = 0.5, 2.0
"""per degree of freedom; beyond, sigmas are wrong by a factor of 1.4 and more"""


def summary(frame: pd.DataFrame, by: Sequence[str], nees: Sequence[Array | None] = ()) -> pd.DataFrame:
    """Summarise a table of runs: a row per combination of the values in the columns `by`, which are the index.

    Means are over the runs that have the metric, with the 95 % interval of Student's t. The mean NEES, 3 for a
    consistent estimator, is judged by the pooled effective number of samples. `nees` has the NEES along each run in the
    order of the frame, None where it is not known; where that is missing, each run counts as a sample.
    """
    import pandas as pd

    numbered, rows = frame.assign(row=range(len(frame))), {}
    for values, group in numbered.groupby(list(by), sort=True):
        names = [Path(value).stem if name == "scene" else str(value) for name, value in zip(by, values, strict=True)]
        rows[tuple(names)] = {
            "runs": len(group),
            "ATE m": mean_interval(_measured(group, "ate_rmse_m")),
            "NEES": _consistency_of(group, nees),
            "NIS/dof": mean_interval(_measured(group, "nis_mean_per_dof")),
            "coverage": mean_interval(_measured(group, "coverage")),
            "outcomes": ", ".join(f"{count} {outcome}" for outcome, count in group["outcome"].value_counts().items()),
        }
    index = pd.MultiIndex.from_tuples(rows, names=list(by)) if rows else pd.Index([])
    return pd.DataFrame(list(rows.values()), index)


def mean_interval(values: Array) -> str:
    """Mean and half-width of its 95 % interval (Student's t) of three values and more; else the values themselves.

    The interval of two is 13 times as wide as what lies between them: they say next to nothing of their mean.
    """
    if len(values) < 3:
        return ", ".join(f"{value:.3g}" for value in values) + " (two say nothing of a mean)" * (len(values) == 2)
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    return f"{values.mean():.3g} ± {half:.2g}"


def pooled(means: Array, own: Array, nees: Sequence[Array]) -> Consistency:
    """The mean NEES of independent runs: their means (R,), the effective samples of each, and the NEES along each.

    The samples are those of all runs about their common mean, and not more than each has. Where they are not known of
    all runs, each run counts as one.
    """
    known, samples = [one[np.isfinite(one)] for one in nees], float(len(means))
    if len(known) == len(own) == len(means):
        samples = min(effective_samples(known), float(own.sum())) if len(means) > 1 else float(own[0])
    return Consistency(float(means.mean()), samples)


def _consistency_of(group: pd.DataFrame, nees: Sequence[Array | None]) -> str:
    """Mean NEES of the runs of a group with its band and the verdict; empty without NEES."""
    measured = group[group[NEES].notna()] if NEES in group else group[:0]
    if not len(measured):
        return ""
    known = [one for k in measured["row"] if nees and (one := nees[k]) is not None]
    found = pooled(measured[NEES].to_numpy(), _measured(measured, EFFECTIVE), known)
    low, high = map(short, found.band)
    return f"{short(found.nees)} ({low} to {high}: {found.outcome})"


def _measured(group: pd.DataFrame, column: str) -> Array:
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

    A run without truth has a line about its scans.
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
        yield f"it stands {length(metrics['goal_error_m'])} from it"


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
        yield f"position error {length(metrics['ate_rmse_m'])} RMS"
        if "dead_reckoning_ate_rmse_m" in metrics:
            yield f"odometry alone {length(metrics['dead_reckoning_ate_rmse_m'])}"
    if "relations_trans_m_mean" in metrics:
        mean, turn = length(metrics["relations_trans_m_mean"]), metrics["relations_rot_deg_mean"]
        yield f"error against the relations {mean} and {turn:.2g}° on average"


def _unmeasured(metrics: Mapping[str, Any]) -> str:
    """The text on accuracy where nothing measures it."""
    if "map_wrong_probability" in metrics:
        return f"no truth; the map is wrong with probability {metrics['map_wrong_probability']:.2g}"
    return "not measured: no truth, no relations"


def _consistency(metrics: Mapping[str, Any]) -> str:
    if NEES in metrics:
        return str(Consistency(metrics[NEES], metrics.get(EFFECTIVE, 1.0)))
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


def length(metres: float) -> str:
    """A length in m, cm or mm."""
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{100.0 * metres:.1f} cm" if metres >= 0.01 else f"{1e3 * metres:.1f} mm"
