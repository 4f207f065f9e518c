import numpy as np
import pandas as pd
from scipy import stats

from sixthsense.evaluation.consistency import effective_samples
from sixthsense.evaluation.results import Metrics, as_text, html_of, side_by_side
from sixthsense.evaluation.summary import run_summary, summary

EXPLORED = {
    "outcome": "explored", "coverage": 0.998, "ate_rmse_m": 0.0123, "dead_reckoning_ate_rmse_m": 1.5,
    "pose_nees_world_mean": 2.9, "pose_nees_effective_samples": 43.0, "path_length_m": 74.12, "sim_time_s": 251.0,
    "area_seen_m2": 117.6, "scans": 2510, "keyframes": 400, "realtime_factor": 44.6, "scan_ms_p50": 6.91,
    "scan_ms_p99": 20.4,
}  # fmt: skip
LOG = {
    "outcome": "log ended", "scans": 13631, "keyframes": 2100, "largest_gap_s": 3.214, "path_length_m": 1508.26,
    "sim_time_s": 2691.0, "area_seen_m2": 811.6, "loop_closures_found": 23,
}  # fmt: skip


def test_a_run_with_truth_has_five_lines():
    found = run_summary(EXPLORED)
    assert found.pop("consistency").startswith("consistent: NEES 2.90, 2.31 to 3.78 is consistent; errors are 0.8")
    assert found == {
        "outcome": "explored; coverage 99.8 %",
        "driven": "74.1 m, 251 s, 118 m² seen",
        "accuracy": "position error 1.2 cm RMS, odometry alone 1.50 m",
        "speed": "44.6 times real time, 6.91 ms a keyframe, 20.4 ms at the 99th percentile",
    }


def test_a_log_without_truth_has_its_scans_the_way_the_area_the_loop_closures_and_the_largest_gap():
    assert run_summary(LOG) == {
        "outcome": "log ended",
        "scans": "13,631 used, 2,100 of them as keyframes, largest gap 3.21 s",
        "driven": "1,508.3 m, 2,691 s, 812 m² seen, 23 loop closures",
        "accuracy": "no truth, no relations",
        "consistency": "not measured: no truth",
    }
    none = LOG | {"loop_closures_found": 0, "keyframes_passed_before": 1250}
    assert run_summary(none)["driven"].endswith(", 0 loop closures, 1,250 keyframes near another pass")
    assert "no covariance of full rank" in run_summary({"ate_rmse_m": 0.03})["consistency"]
    relations = {"relations_trans_m_mean": 0.026, "relations_rot_deg_mean": 0.451}
    assert run_summary(LOG | relations)["accuracy"] == "error against the relations 2.6 cm, 0.45° on average"
    for nis, size in ((0.49, "larger"), (0.51, ""), (1.99, ""), (2.01, "smaller")):
        told = run_summary(LOG | {"nis_mean_per_dof": nis})["consistency"]
        assert told.startswith(f"no truth; NIS {nis} per degree of freedom, 1 is consistent")
        assert ("assumed noise" in told) == bool(size) and size in told


def test_a_table_of_runs_has_means_with_intervals_of_student_bands_and_outcomes_by_group():
    """Rows of two groups in mixed order; of the effective samples the smaller of pooled and summed ones counts."""
    rng = np.random.default_rng(6)
    nees = [rng.chisquare(3, 70) * (1.0 + 0.03 * k) for k in range(7)]
    frame = pd.DataFrame({
        "scene": ["maps/b.toml", "a", "maps/b.toml", "a", "a", "maps/b.toml", "a"],
        "outcome": ["explored", "stuck", "lost", "explored", "explored", "lost", "explored"],
        "ate_rmse_m": [0.03, 0.07, 0.052, 0.011, np.nan, 0.041, 0.024],
        "nis_mean_per_dof": [1.1] + [np.nan] * 6, "pose_nees_world_mean": [one.mean() for one in nees],
        "pose_nees_effective_samples": [66.0, 70.0, 61.0, 70.0, 70.0, 58.0, 70.0],
    })  # fmt: skip
    table = summary(frame, ["scene"], nees)
    assert table.index.get_level_values("scene").tolist() == ["a", "b"] and table["runs"].tolist() == [4, 3]
    for (_, row), members in zip(table.iterrows(), ([1, 3, 4, 6], [0, 2, 5]), strict=True):
        ate = frame["ate_rmse_m"][members].dropna()
        low, high = stats.t.interval(0.95, len(ate) - 1, ate.mean(), stats.sem(ate))
        assert row["ATE m"] == f"{ate.mean():.3g} ± {(high - low) / 2:.2g}"
        worth = min(effective_samples([nees[k] for k in members]), frame["pose_nees_effective_samples"][members].sum())
        low, high = stats.chi2.ppf((0.025, 0.975), 3 * worth) / worth
        mean = np.mean([nees[k].mean() for k in members])
        outcome = "consistent" if low <= mean <= high else "overconfident" if mean > high else "cautious"
        assert worth > 30.0 and row["NEES"] == f"{mean:.2f} ({low:.2f} to {high:.2f}: {outcome})"
    assert table["NIS/dof"].tolist() == ["", "1.1"]
    assert table["outcomes"].tolist() == ["3 explored, 1 stuck", "2 lost, 1 explored"]
    low, high = stats.chi2.ppf((0.025, 0.975), 3 * 4) / 4  # of four runs, each one sample
    few = summary(frame.assign(pose_nees_world_mean=0.4), ["scene"])
    assert few["NEES"].iloc[0] == f"0.40 ({low:.2f} to {high:.2f}: too short to tell)"


def test_metrics_of_runs_stand_side_by_side_with_units_in_the_order_of_the_table():
    one = Metrics({"own": 1.5, "guard_stops": 3, "ate_rmse_m": 0.123456})
    table = side_by_side({"one": one, "<b>": {"ate_rmse_m": 7.25}})
    assert (
        table.index.tolist() == ["ate_rmse_m", "guard_stops", "own"] and table["<b>"].isna().tolist()[1:] == [True] * 2
    )
    assert table.attrs["units"] == {"ate_rmse_m": "m", "guard_stops": "", "own": ""} == dict(table["unit"])
    assert one.frame()["value"].tolist() == [0.123456, 3, 1.5] and one.frame().attrs["units"]["ate_rmse_m"] == "m"
    shown = as_text(table)
    assert shown.loc[("Accuracy", "ate_rmse_m"), "one"] == "0.1235" and shown.loc[("Other", "own"), "<b>"] == ""
    assert "&lt;b&gt;" in html_of(shown) and "<b>" not in html_of(shown)
