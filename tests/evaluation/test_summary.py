import numpy as np
import pytest
from scipy import stats

from sixthsense.evaluation.effective import effective_samples
from sixthsense.evaluation.results import Metrics
from sixthsense.evaluation.summary import mean_interval, run_summary, summary
from sixthsense.evaluation.tables import digits, html_table, text_table

EXPLORED = {
    "outcome": "explored", "coverage": 0.998, "ate_rmse_m": 0.0123, "dead_reckoning_ate_rmse_m": 1.5,
    "pose_nees_world_mean": 2.9, "path_length_m": 74.12, "sim_time_s": 251.0, "area_seen_m2": 117.6, "scans": 2510,
    "keyframes": 400, "realtime_factor": 44.6, "scan_ms_p50": 6.91, "scan_ms_p99": 20.4,
}  # fmt: skip
LOG = {
    "outcome": "log ended", "scans": 13631, "keyframes": 2100, "largest_gap_s": 3.214, "path_length_m": 1508.26,
    "sim_time_s": 2691.0, "area_seen_m2": 811.6, "loop_closures_found": 23,
}  # fmt: skip


def test_a_run_with_truth_is_told_in_five_lines():
    assert run_summary(EXPLORED) == {
        "outcome": "explored: the robot saw all that it could; coverage 99.8 %",
        "driven": "74.1 m in 251 s, 118 m² seen",
        "accuracy": "position error 1.2 cm RMS; odometry alone 1.50 m",
        "consistency": "consistent: NEES 2.9, within the 0.2 to 9.3 of a consistent run",
        "speed": "45 times real time; 6.9 ms a keyframe, 20 ms at the 99th percentile",
    }


def test_a_log_without_truth_tells_its_scans_the_way_the_area_the_loop_closures_and_the_largest_gap():
    assert run_summary(LOG) == {
        "outcome": "log ended: the log was processed to its end",
        "scans": "13,631 used, 2,100 of them as keyframes; largest gap 3.21 s",
        "driven": "1,508.3 m in 2,691 s, 812 m² seen, 23 loop closures",
        "accuracy": "not measured: no truth, no relations",
        "consistency": "not measured: no truth",
    }
    told = run_summary(
        LOG | {"relations_trans_m_mean": 0.026, "relations_rot_deg_mean": 0.451, "nis_mean_per_dof": 1.02}
    )
    assert told["accuracy"] == "error against the relations 2.6 cm and 0.45° on average"
    assert told["consistency"] == "no truth; NIS 1.02 per degree of freedom, 1 is consistent"


@pytest.mark.parametrize(("nis", "size"), [(0.49, "larger"), (0.51, ""), (1.99, ""), (2.01, "smaller")])
def test_a_nis_that_says_that_the_tuning_is_of_another_robot_says_what_to_do(nis: float, size: str) -> None:
    told = run_summary(LOG | {"nis_mean_per_dof": nis})["consistency"]
    advice = f": the assumed noise is {size} than the robot's; assumed.laser and assumed.motion state it"
    assert told == f"no truth; NIS {nis:.2f} per degree of freedom, 1 is consistent{advice if size else ''}"


@pytest.mark.parametrize(
    ("samples", "told"), [(60.0, "overconfident: NEES 4, above the 2.4 to 3.7"), (29.0, "consistent")]
)
def test_the_band_is_that_of_the_effective_samples_if_they_are_enough_to_know_their_number(samples, told):
    metrics = EXPLORED | {"pose_nees_world_mean": 4.0, "pose_nees_effective_samples": samples}
    assert run_summary(metrics)["consistency"].startswith(told)


@pytest.mark.parametrize(("changes", "label", "told"), [
    ({"pose_nees_world_mean": 0.21}, "consistency", "cautious: NEES 0.21, below the 0.2 to 9.3"),
    ({"pose_nees_world_mean": 9.4}, "consistency", "overconfident: NEES 9.4, above the 0.2 to 9.3"),
    ({"outcome": "goal reached", "goal_error_m": 0.0074}, "outcome", "it stands 7.4 mm from it"),
    ({"outcome": "explored in part"}, "outcome", "some places are left unseen; coverage 99.8 %"),
    ({"ate_rmse_m": 0.999, "dead_reckoning_ate_rmse_m": 1.004}, "accuracy", "99.9 cm RMS; odometry alone 1.00 m"),
    ({"scan_ms_p50": 10.4, "scan_ms_p99": 9.96}, "speed", "10 ms a keyframe, 10 ms at the 99th percentile"),
])  # fmt: skip
def test_limits_units_and_outcomes_of_a_summary(changes, label, told):
    assert told in run_summary(EXPLORED | changes)[label]


def test_a_table_of_runs_has_means_with_intervals_of_student_bands_and_outcomes_by_group():
    """Rows of two groups in mixed order; of the effective samples the smaller of pooled and summed ones counts."""
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(6)
    nees = [rng.chisquare(3, 70) * (1.0 + 0.03 * k) for k in range(7)]
    frame = pd.DataFrame({
        "scene": ["maps/b.toml", "a", "maps/b.toml", "a", "a", "maps/b.toml", "a"],
        "outcome": ["explored", "stuck", "lost", "explored", "explored", "lost", "explored"],
        "ate_rmse_m": [0.03, 0.07, 0.052, 0.011, np.nan, 0.041, 0.024],
        "nis_mean_per_dof": [1.1] + [np.nan] * 6, "pose_nees_world_mean": [one.mean() for one in nees],
        "pose_nees_effective_samples": [66.0, 70.0, 61.0, 70.0, 70.0, 58.0, 70.0],
    })  # fmt: skip
    head, *rows = summary(frame, ["scene"], nees)
    assert head == ["scene", "runs", "ATE m", "NEES", "NIS/dof", "coverage", "outcomes"]
    for row, name, members in zip(rows, ("a", "b"), ([1, 3, 4, 6], [0, 2, 5]), strict=True):
        ate = frame["ate_rmse_m"][members].dropna()
        low, high = stats.t.interval(0.95, len(ate) - 1, ate.mean(), stats.sem(ate))
        assert row[:3] == [name, str(len(members)), f"{ate.mean():.3g} ± {(high - low) / 2:.2g}"]
        worth = min(effective_samples([nees[k] for k in members]), frame["pose_nees_effective_samples"][members].sum())
        assert worth > 30.0
        low, high = stats.chi2.ppf((0.025, 0.975), 3 * worth) / worth
        mean = np.mean([nees[k].mean() for k in members])
        assert row[3] == f"{mean:.3g} {'in' if low < mean < high else 'not in'} {low:.2f}-{high:.2f}"
    assert [row[4:6] for row in rows] == [["", ""], ["1.1", ""]]
    assert [row[6] for row in rows] == ["3 explored, 1 stuck", "2 lost, 1 explored"]
    few = frame.assign(pose_nees_effective_samples=7.0, pose_nees_world_mean=0.4)
    low, high = stats.chi2.ppf((0.025, 0.975), 3 * 4) / 4  # of four runs
    assert summary(few, ["scene"], nees)[1][3] == f"0.4 not in {low:.2f}-{high:.2f}"
    assert summary(few, ["scene"])[1][3] == f"0.4 not in {low:.2f}-{high:.2f}"


def test_the_interval_of_a_mean_is_that_of_student():
    values = np.array([0.31, 0.52, 0.47, 0.93, 0.11])
    low, high = stats.t.interval(0.95, 4, values.mean(), stats.sem(values))
    assert mean_interval(values) == f"{values.mean():.3g} ± {(high - low) / 2:.2g}"
    two = "0.31, 0.52 (two runs say nothing of a mean)"
    assert [mean_interval(values[:n]) for n in (0, 1, 2)] == ["", "0.31", two]


def test_tables_align_escape_and_round_their_cells():
    rows = [
        ["key", "value", "unit"], ["a heading that is long"], ["ate", digits(0.0123456), "m"], ["n", digits(7), "1"],
    ]  # fmt: skip
    assert text_table(rows, "right").splitlines()[2:] == ["ate  0.01235     m", "n          7     1"]
    assert text_table(rows).splitlines()[3] == "n    7        1"
    assert (
        html_table(["<b>", "d"], [["a & b", "c"]], 0)
        == "<table>\n<tr><th>&lt;b&gt;</th><th>d</th></tr>\n<tr><td>a &amp; b</td><td>c</td></tr>\n</table>"
    )
    told = repr(Metrics({"ate_max_m": 0.123456, "guard_stops": 3, "plans_below_margin": 0, "own": 1.5})).splitlines()
    assert told == ["Accuracy", "  ate_max_m           0.1235 m", "Map and path", "  plans_below_margin  0",
                    "  guard_stops         3", "Other", "  own                 1.5"]  # fmt: skip
