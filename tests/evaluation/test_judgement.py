import pytest

from sixthsense.evaluation.judgement import judgement
from sixthsense.evaluation.results import Metrics

EXPLORED = {
    "outcome": "explored", "coverage": 0.998, "ate_rmse_m": 0.0123, "dead_reckoning_ate_rmse_m": 1.5,
    "pose_nees_world_mean": 2.9,
}  # fmt: skip


def test_the_judgement_is_one_sentence_on_task_accuracy_and_consistency():
    assert judgement(EXPLORED) == (
        "The robot saw all that it could; 99.8 % of the visible area was seen; position error 1.2 cm RMS "
        "(odometry alone: 1.50 m); covariance consistent (NEES 2.9; 0.2 to 9.3 is expected of one run)."
    )


@pytest.mark.parametrize(("nees", "word"), [(12.0, "overconfident"), (3.0, "consistent"), (0.1, "cautious")])
def test_the_covariance_is_judged_by_the_band_of_a_single_run(nees, word):
    assert f"covariance {word} (" in judgement(EXPLORED | {"pose_nees_world_mean": nees})


def test_what_was_not_measured_is_not_judged():
    assert judgement({"outcome": "log ended"}) == "The log was processed to its end."
    assert judgement({"outcome": "something else"}) == "The run ended: something else."
    assert "relations 2.6 cm" in judgement({"outcome": "log ended", "relations_trans_m_mean": 0.026})
    assert "stands 4.0 mm from it" in judgement({"outcome": "goal reached", "goal_error_m": 0.004})


def test_paths_with_less_than_the_margin_are_said_to_be_usual_where_there_are_any():
    assert "usual: doors" in repr(Metrics(outcome="explored", plans_below_margin=91))
    assert "usual: doors" not in repr(Metrics(outcome="explored", plans_below_margin=0))
