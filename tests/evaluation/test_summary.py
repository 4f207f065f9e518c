import pytest

from sixthsense.evaluation.summary import run_summary

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


@pytest.mark.parametrize(
    ("samples", "told"), [(60.0, "overconfident: NEES 4, above the 2.4 to 3.7"), (29.0, "consistent")]
)
def test_the_band_is_that_of_the_effective_samples_if_they_are_enough_to_know_their_number(samples, told):
    metrics = EXPLORED | {"pose_nees_world_mean": 4.0, "pose_nees_effective_samples": samples}
    assert run_summary(metrics)["consistency"].startswith(told)
