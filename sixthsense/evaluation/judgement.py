"""One sentence about a run: what was done, how far off the pose was, and whether its covariance agrees with that."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sixthsense.evaluation.metrics import nees_band

_OUTCOMES = {
    "explored": "the robot saw all that it could",
    "explored in part": "the robot explored, but for the places it lists",
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


def judgement(metrics: Mapping[str, Any]) -> str:
    """The sentence for the metrics of a run; it leaves out what was not measured.

    A single run's mean NEES says little, since its steps are correlated: only one outside the 95 % band of a single
    draw is called inconsistent.
    """
    outcome = str(metrics.get("outcome", "unknown"))
    parts = [_OUTCOMES.get(outcome, f"the run ended: {outcome}"), *_on_accuracy(metrics), *_on_consistency(metrics)]
    sentence = "; ".join(parts)
    return f"{sentence[0].upper()}{sentence[1:]}."


def _on_accuracy(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "coverage" in metrics and str(metrics.get("outcome")).startswith("explored"):
        yield f"{100.0 * metrics['coverage']:.4g} % of the visible area was seen"
    if "goal_error_m" in metrics and metrics.get("outcome") == "goal reached":
        yield f"it stands {_length(metrics['goal_error_m'])} from it"
    if "ate_rmse_m" in metrics:
        odometry = metrics.get("dead_reckoning_ate_rmse_m")
        alone = "" if odometry is None else f" (odometry alone: {_length(odometry)})"
        yield f"position error {_length(metrics['ate_rmse_m'])} RMS{alone}"
    if "relations_trans_m_mean" in metrics:
        yield f"error against the relations {_length(metrics['relations_trans_m_mean'])} on average"


def _on_consistency(metrics: Mapping[str, Any]) -> Iterator[str]:
    if "pose_nees_world_mean" not in metrics:
        return
    nees = metrics["pose_nees_world_mean"]
    low, high = nees_band(1)
    verdict = "overconfident" if nees > high else "cautious" if nees < low else "consistent"
    yield f"covariance {verdict} (NEES {nees:.2g}; {low:.1f} to {high:.1f} is expected of one run)"


def _length(metres: float) -> str:
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{100.0 * metres:.1f} cm" if metres >= 0.01 else f"{1e3 * metres:.1f} mm"
