"""How runs show themselves: metrics, figures, cards and comparisons."""

import json
import pickle
from html.parser import HTMLParser

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


class Text(HTMLParser):
    """The words of a page, and a complaint for an element that is not closed."""

    def __init__(self, page):
        super().__init__()
        self.words, self.open = [], []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in ("br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


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


def test_a_run_is_shown_as_a_card_with_its_map_and_what_matters_most(run):
    page = run._repr_html_()
    words = Text(page).words
    assert "rectangle: ekf-invariant · default · seed 1 · explored" in words
    assert {"ate_rmse_m", f"{run.metrics['ate_rmse_m']:.4g} m"} <= set(words)
    assert 'src="data:image/png;base64,' in page
    assert (
        repr(run) == f"<Run of rectangle, ekf-invariant, default, seed 1: explored, {len(run.trace.stamps_ns)} scans>"
    )


def test_a_comparison_is_a_table_for_people_and_a_frame_for_pandas(run, other):
    both = ss.compare({"one": run, "<b>": other})
    frame = both.frame()
    assert list(frame.index) == ["one", "<b>"] and frame.index.name == "run"
    assert frame.loc["one", "ate_rmse_m"] == run.metrics["ate_rmse_m"]
    assert frame.isna().loc["<b>", "home_error_m"]
    page = both._repr_html_()
    assert {"one", "<b>", f"{other.metrics['ate_rmse_m']:.4g} m"} <= set(Text(page).words)
    assert "<b>" not in page.replace("<b>2 runs</b>", "")
    head, first, _ = repr(both).splitlines()
    assert head.split()[:3] == ["run", "outcome", "ate_rmse_m"] and first.split()[:2] == ["one", "explored"]


def test_folders_are_compared_by_their_names(run, tmp_path):
    ss.run("rectangle", task="tour", max_time=3.0, out=tmp_path / "here")
    both = ss.compare([tmp_path / "here", run])
    assert both.names == ["here", "rectangle"]
    assert both.runs[0].metrics["outcome"] == "tour ended"
