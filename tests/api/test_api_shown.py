"""How runs show themselves: metrics, figures, cards and comparisons."""

import dataclasses
import io
import json
import pickle
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

import sixthsense as ss
from sixthsense.evaluation.results import QUANTITIES, Metrics
from sixthsense.figures.panels import KINDS
from sixthsense.loop import run as simulated


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


def size(picture):
    with Image.open(io.BytesIO(picture.png())) as image:
        image.load()
        return image.size


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


def test_metrics_are_printed_in_groups_with_units(run):
    lines = repr(run.metrics).splitlines()
    width = max(map(len, run.metrics))
    assert lines[:2] == ["Outcome", f"  {'outcome':{width}}  explored"]
    assert f"  {'ate_rmse_m':{width}}  {run.metrics['ate_rmse_m']:.4g} m" in lines
    assert lines.index("Accuracy") < lines.index("Consistency") < lines.index("Time")
    assert repr(Metrics()) == ""


def test_metrics_are_shown_as_a_table_in_which_everything_is_escaped(run):
    words = Text(run.metrics._repr_html_()).words
    assert {"ate_rmse_m", f"{run.metrics['ate_rmse_m']:.4g} m", "Consistency", "explored"} <= set(words)
    page = Metrics({"outcome": "<b>&", "<i>": 1.0})._repr_html_()
    assert "<b>" not in page and "<i>" not in page and "&lt;b&gt;&amp;" in page and "Other" in page


def test_metrics_become_a_frame_with_units(run):
    frame = run.metrics.frame()
    assert list(frame.columns) == ["value", "unit", "meaning", "group"]
    assert frame.loc["ate_rmse_m", "value"] == run.metrics["ate_rmse_m"]
    assert frame.loc["ate_rmse_m", "unit"] == "m"
    assert set(frame.index) == set(run.metrics)


def test_without_pandas_a_frame_says_in_one_line_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    for shown in (run.metrics, ss.compare([run])):
        with pytest.raises(ss.InputError, match=r"pandas: cannot be imported .*pip install 'sixthsense\[notebooks\]'"):
            shown.frame()


@pytest.mark.parametrize("what", sorted({*KINDS} - {"rpe"}))  # the robot drives less than a metre here
def test_a_run_draws_each_kind_of_figure_and_two_side_by_side(run, other, what):
    width, height = size(run.plot(what))
    assert width > 500 and height > 150
    assert size(ss.compare([run, other]).plot(what))[0] > 500


def test_a_figure_that_there_is_not_is_refused_in_one_line(run):
    blind = ss.Run("blind", dataclasses.replace(run.trace, scene=None, truths=[], key_truths=[]))
    with pytest.raises(ss.InputError, match=r"what: found 'maps', did you mean map\? allowed: map, error, rpe, nees"):
        run.plot("maps")
    with pytest.raises(ss.InputError, match="nees: found a run without the truth at keyframes, allowed: a run that"):
        blind.plot("nees")
    assert "ate_rmse_m" not in blind.metrics


def test_a_figure_shows_itself_without_pyplot(run):
    assert run.plot()._repr_png_()[:4] == b"\x89PNG"


def test_a_run_is_shown_as_a_card_with_its_map_and_what_matters_most(run):
    page = run._repr_html_()
    words = Text(page).words
    assert "rectangle: ekf-invariant · default · seed 1 · explored" in words
    assert {"ate_rmse_m", f"{run.metrics['ate_rmse_m']:.4g} m"} <= set(words)
    assert 'src="data:image/png;base64,' in page
    assert (
        repr(run) == f"<Run of rectangle, ekf-invariant, default, seed 1: explored, {len(run.trace.stamps_ns)} scans>"
    )


def test_what_a_card_says_is_escaped(run):
    named = ss.Run("<script>", run.trace)
    assert "<script>" not in named._repr_html_() and "&lt;script&gt;" in named._repr_html_()


def test_runs_are_compared_under_what_tells_them_apart(run, other):
    both = ss.compare([run, other])
    assert both.names == ["ekf-invariant · explore · max_time None", "isam2 · tour · max_time 10.0"]
    assert ss.compare([run, run]).names == ["rectangle (1)", "rectangle (2)"]
    assert ss.compare({"one": run, "two": other}).names == ["one", "two"]
    assert [one.trace for one in both] == [run.trace, other.trace] and len(both) == 2


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


@pytest.mark.parametrize(
    ("runs", "complaint"),
    [
        ([], "runs: found none, allowed: one or more"),
        ({}, "runs: found none"),
        ([3], "runs: found 3, allowed: runs, folders of runs, or campaigns"),
        ({"a": None}, "runs: found None, allowed: runs, folders of runs, or camp"),
        ("runs/one", "runs: found 'runs/one', allowed: a list"),
        (["nowhere"], "nowhere: found no such folder"),
    ],
)
def test_what_cannot_be_compared_is_told_in_one_line(runs, complaint):
    with pytest.raises(ss.InputError, match=complaint):
        ss.compare(runs)


def test_a_picture_keeps_the_colours_of_a_legends_thin_lines(run, other):
    figure = ss.compare([run, other]).plot("nees")
    plain = io.BytesIO()
    figure.savefig(plain, format="png", dpi=75, bbox_inches="tight", pad_inches=0.12)
    with Image.open(plain) as drawn, Image.open(io.BytesIO(figure.png())) as shown:
        off = np.abs(np.asarray(drawn.convert("RGB"), dtype=int) - np.asarray(shown.convert("RGB"), dtype=int))
    assert off.max() < 25
