"""Summary of runs: one run in a few lines, and a table of many, with means, intervals and outcomes by group."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.evaluation.consistency import Consistency, effective_samples, short

if TYPE_CHECKING:
    import pandas as pd

NEES, EFFECTIVE = "pose_nees_world_mean", "pose_nees_effective_samples"
_NIS = 0.5, 2.0
"""per degree of freedom; beyond, sigmas are wrong by a factor of 1.4 and more"""
_MEANS = {"ATE m": "ate_rmse_m", "NEES": NEES, "NIS/dof": "nis_mean_per_dof", "coverage": "coverage"}
_LINES = {
    "unmeasured": {"map_wrong_probability": "no truth; the map is wrong with probability {:.2g}"},
    "scans": {"scans": "{:,} used", "keyframes": "{:,} of them as keyframes", "largest_gap_s": "largest gap {:.3g} s"},
    "driven": {
        "path_length_m": "{:,.1f} m", "sim_time_s": "{:,.0f} s", "area_seen_m2": "{:,.0f} m² seen",
        "loop_closures_found": "{:,} loop closures", "keyframes_passed_before": "{:,} keyframes near another pass",
    },
    "accuracy": {
        "ate_rmse_m": "position error {length} RMS", "dead_reckoning_ate_rmse_m": "odometry alone {length}",
        "relations_trans_m_mean": "error against the relations {length}",
        "relations_rot_deg_mean": "{:.2g}° on average",
    },
    "speed": {
        "realtime_factor": "{short} times real time", "scan_ms_p50": "{short} ms a keyframe",
        "scan_ms_p99": "{short} ms at the 99th percentile",
    },
}  # fmt: skip
"""what lines of a summary say of metrics"""


def summary(frame: pd.DataFrame, by: Sequence[str], nees: Sequence[Array | None] = ()) -> pd.DataFrame:
    """Summarise a table of runs: a row per combination of the values in the columns `by`, which are the index.

    Means are over the runs that have the metric, with the 95 % interval of Student's t. The mean NEES, 3 for a
    consistent estimator, is judged by the pooled effective number of samples. `nees` has the NEES along each run in the
    order of the frame, None where it is not known; where that is missing, each run counts as a sample.
    """
    import pandas as pd

    rows = {}
    for values, group in frame.reset_index(drop=True).groupby(list(by), sort=True):
        names = [Path(value).stem if name == "scene" else str(value) for name, value in zip(by, values, strict=True)]
        along = [one for k in group.index if nees and (one := nees[k]) is not None]
        means = {title: mean_interval(_measured(group, key)) for title, key in _MEANS.items()}
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in group["outcome"].value_counts().items())
        judged = {"NEES": _consistency_of(group, along), "outcomes": outcomes}
        rows[tuple(names)] = {"runs": len(group), **means, **judged}
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


def _consistency_of(group: pd.DataFrame, along: Sequence[Array]) -> str:
    """Mean NEES of the runs of a group with its band and the verdict; empty without NEES."""
    if not len(means := _measured(group, NEES)):
        return ""
    found = pooled(means, _measured(group, EFFECTIVE), along)
    low, high = map(short, found.band)
    return f"{short(found.nees)} ({low} to {high}: {found.outcome})"


def _measured(group: pd.DataFrame, column: str) -> Array:
    values = group[column].to_numpy(dtype=np.float64) if column in group else np.zeros(0)
    return np.asarray(values[np.isfinite(values)])


def run_summary(metrics: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a run's summary, label and text, from its metrics.

    A run without truth has a line about its scans.
    """
    parts = {
        "outcome": "; ".join(_outcome(metrics)),
        "map": str(metrics.get("verdict", "")),
        "scans": "" if "ate_rmse_m" in metrics else _line(metrics, "scans"),
        "driven": _line(metrics, "driven"),
        "accuracy": _line(metrics, "accuracy") or _line(metrics, "unmeasured") or "no truth, no relations",
        "consistency": _consistency(metrics),
        "speed": _line(metrics, "speed"),
    }
    return {label: text for label, text in parts.items() if text}


def _line(metrics: Mapping[str, Any], label: str) -> str:
    known = [(form, metrics[name]) for name, form in _LINES[label].items() if name in metrics]
    return ", ".join(form.format(value, length=length(value), short=short(value)) for form, value in known)


def _outcome(metrics: Mapping[str, Any]) -> Iterator[str]:
    yield (outcome := str(metrics.get("outcome", "unknown")))
    if "coverage" in metrics and outcome.startswith("explored"):
        yield f"coverage {100.0 * metrics['coverage']:.4g} %"
    if "goal_error_m" in metrics and outcome == "goal reached":
        yield f"it stands {length(metrics['goal_error_m'])} from it"


def _consistency(metrics: Mapping[str, Any]) -> str:
    if NEES in metrics:
        return str(Consistency(metrics[NEES], metrics.get(EFFECTIVE, 1.0)))
    why = "no covariance of full rank, as of a robot that hardly moves" if "ate_rmse_m" in metrics else "no truth"
    if (nis := metrics.get("nis_mean_per_dof")) is None:
        return f"not measured: {why}"
    said = f"{why}; NIS {nis:.2f} per degree of freedom, 1 is consistent"
    if _NIS[0] <= nis <= _NIS[1]:
        return said
    size = "larger" if nis < _NIS[0] else "smaller"
    return f"{said}: the assumed noise is {size} than the robot's; assumed.laser and assumed.motion state it"


def length(metres: float) -> str:
    """A length in m, cm or mm."""
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{100.0 * metres:.1f} cm" if metres >= 0.01 else f"{1e3 * metres:.1f} mm"
