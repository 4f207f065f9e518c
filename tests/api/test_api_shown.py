"""How runs show themselves: metrics, figures, cards and comparisons."""

import json
import pickle

import pytest

import sixthsense as ss
from sixthsense.evaluation.results import QUANTITIES, Metrics
from sixthsense.loop.run import run as simulated


@pytest.fixture
def run(explored) -> ss.Run:
    return explored


@pytest.fixture(scope="module")
def other() -> ss.Run:
    return ss.run("rectangle", seed=1, estimator="isam2", task="tour", max_time=10.0)


def test_every_metric_of_a_run_is_described(run):
    assert set(run.metrics) <= set(QUANTITIES)
    assert all(quantity.meaning for quantity in QUANTITIES.values())


def test_metrics_are_a_dictionary_that_json_and_pickle_take(run):
    assert isinstance(run.metrics, dict)
    assert json.loads(json.dumps(run.metrics)) == run.metrics
    again = pickle.loads(pickle.dumps(run.metrics))
    assert type(again) is Metrics and again == run.metrics


def test_metrics_are_measured_once_and_handed_out_as_copies(run, monkeypatch):
    before = run.metrics
    monkeypatch.setattr("sixthsense.evaluation.measured_run.measure", None)
    run.metrics["outcome"] = "changed"
    assert run.metrics == before


def test_metrics_of_a_run_that_goes_on_are_those_of_now():
    seen = []
    simulated(
        ss.preset(scene="rectangle", task="tour", max_time=2.0), lambda tick, trace: seen.append(trace.path_length_m)
    )
    traces = []

    def look(tick, trace):
        if len(traces) < 40:
            traces.append(ss.Run("so far", trace).metrics["path_length_m"])

    run = simulated(ss.preset(scene="rectangle", task="tour", max_time=2.0), look)
    assert traces == seen[:40]
    assert ss.Run("all", run).metrics["path_length_m"] == seen[-1]


def test_a_comparison_is_a_table_for_people_and_a_frame_for_pandas(run, other):
    both = ss.compare({"one": run, "<b>": other})
    frame = both.frame()
    assert list(frame.index) == ["one", "<b>"] and frame.index.name == "run"
    assert frame.loc["one", "ate_rmse_m"] == run.metrics["ate_rmse_m"]
    assert frame.isna().loc["<b>", "home_error_m"]
    assert "<b>" not in both._repr_html_() and frame.attrs["units"]["ate_rmse_m"] == "m"


def test_folders_are_compared_by_their_names(run, tmp_path):
    ss.run("rectangle", task="tour", max_time=3.0, out=tmp_path / "here")
    both = ss.compare([tmp_path / "here", run])
    assert both.names == ["here", "rectangle"]
    assert both.runs[0].metrics["outcome"] == "tour ended"
