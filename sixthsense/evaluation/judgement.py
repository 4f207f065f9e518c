"""What a run has come to, in a line each: outcome, way, accuracy, consistency and speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sixthsense.evaluation.effective import EFFECTIVE, band_of_runs

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


def summary(metrics: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a run's summary, label and text, from its metrics.

    A run without truth has a line about its scans. The steps of a run are correlated: its mean NEES is judged by the
    95 % band for its effective number of samples, and with fewer than 30 by that of a single sample.
    """
    parts = {
        "outcome": "; ".join(_outcome(metrics)),
        "scans": "" if "ate_rmse_m" in metrics else "; ".join(_scans(metrics)),
        "driven": ", ".join(_driven(metrics)),
        "accuracy": "; ".join(_accuracy(metrics)) or "not measured: no truth, no relations",
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


def _consistency(metrics: Mapping[str, Any]) -> str:
    if "pose_nees_world_mean" in metrics:
        nees = metrics["pose_nees_world_mean"]
        low, high = band_of_runs(metrics.get(EFFECTIVE, 1.0))
        verdict, where = ("consistent", "within") if low <= nees <= high else ("overconfident", "above")
        if nees < low:
            verdict, where = "cautious", "below"
        return f"{verdict}: NEES {nees:.2g}, {where} the {low:.1f} to {high:.1f} of a consistent run"
    if "nis_mean_per_dof" in metrics:
        return f"no truth; NIS {metrics['nis_mean_per_dof']:.2f} per degree of freedom, 1 is consistent"
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
