import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from sixthsense.cli import main
from sixthsense.config import preset
from sixthsense.evaluation.results import Metrics
from sixthsense.figures.report import report
from sixthsense.figures.report_page import page
from sixthsense.figures.run import Run, load
from sixthsense.record.trace import Trace

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """The tags, the words and the attributes of a page; every tag that is opened is closed in turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.tags: set[str] = set()
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return "".join(self.words)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one"
    assert main(["run", "rectangle", "--seed", "2", "--estimator", "ekf-fej", "--out", str(out)]) == 0
    assert main(["report", str(out), "--figures", "svg"]) == 0
    return out


@pytest.fixture(scope="module")
def text(folder) -> str:
    return (folder / "figures" / "report.html").read_text(encoding="utf-8")


def shown(name: str = "a", metrics=None, folder: Path | None = None, **fields) -> Run:
    trace = Trace(preset(**fields), None, 0.2, outcome="explored")
    return Run(name, trace, Metrics(metrics or {"ate_rmse_m": 1.0}), folder)


def noted(folder: Path, notes: str) -> Path:
    """A run's folder of which there is no more than what its configuration notes."""
    folder.mkdir()
    (folder / "config.toml").write_text(notes, encoding="utf-8")
    return folder


def test_the_page_is_valid_and_needs_no_other_files(text):
    parsed = Page(text)
    named = [value for _, name, value in parsed.attributes if name in ("src", "href", "srcset", "data", "action")]
    loading = [value for value in named if not value.startswith("#")]
    assert loading
    assert all(value.startswith("data:image/png;base64,") for value in loading)
    assert parsed.tags.isdisjoint({"script", "link", "iframe", "object"})
    assert re.search(r"url\(|@import|https?:", text) is None


def test_the_contents_lead_to_each_figure_and_section(folder, text):
    parsed = Page(text)
    targets = [value for tag, name, value in parsed.attributes if (tag, name) == ("a", "href")]
    places = [f"#{value}" for _, name, value in parsed.attributes if name == "id"]
    assert sorted(targets) == sorted(places) and len(set(places)) == len(places)
    assert {f"#figure-{file.stem}" for file in (folder / "figures").glob("*.png")} <= set(targets)
    assert {"#metrics", "#figures", "#configuration", "#reproduction"} <= set(targets)


def test_a_picture_is_described_for_who_cannot_see_it(text):
    for tag, name, value in Page(text).attributes:
        assert (tag, name) != ("img", "alt") or len(value) > 40


def test_the_page_contains_each_figure(folder, text):
    pictures = [value for tag, name, value in Page(text).attributes if (tag, name) == ("img", "src")]
    held = {base64.b64decode(value.partition(",")[2]) for value in pictures}
    assert held == {file.read_bytes() for file in (folder / "figures").glob("*.png")}


def test_the_page_has_every_metric_the_configuration_the_versions_and_the_command_that_repeats_the_run(folder, text):
    said = Page(text).text
    for key in load(folder).metrics:
        assert key in said
    assert f"sixthsense run --config {folder}/config.toml" in said
    assert "estimatorekf-fejekf" in said  # different field, this run, default
    assert (folder / "config.toml").read_text(encoding="utf-8") in said
    assert re.search(r"Run by sixthsense [\d.]+, python 3[\d.]+, numpy ", said)


def test_every_external_text_is_escaped(tmp_path):
    nasty = '<b onload="x">&amp;'
    quoted = json.dumps(nasty)
    notes = f"[versions]\n{quoted} = {quoted}\n[replayed]\nlog = {quoted}\n{quoted} = {quoted}\n"
    metrics = {"outcome": nasty, nasty: nasty}
    run = shown(nasty, metrics, noted(tmp_path / nasty, notes), scene=nasty)
    for runs in ([run], [run, shown()]):
        text = page(runs, [])
        parsed = Page(text)
        assert "b" not in parsed.tags
        assert "<b " not in text
        assert nasty in parsed.text


def test_several_runs_have_a_column_each_and_only_the_settings_that_differ():
    one = shown("one", {"ate_rmse_m": 0.25, "plans": 3}, seed=1, estimator="isam2")
    two = shown("two", {"ate_rmse_m": 0.5, "outcome": "stuck"}, seed=2, estimator="isam2")
    text = page([one, two], [])
    said = Page(text).text
    assert "Runs compared: one, two" in said
    assert "two: stuck" in said
    changed = said.partition("different field")[2].partition("Complete configuration")[0]
    assert "seed12" in changed
    assert "estimator" not in changed


def test_the_command_of_a_replay_has_its_log_and_its_relations(tmp_path):
    notes = "[replayed]\nlog = '/logs/my log.clf'\nrelations = 'r.txt'\n"
    folder = noted(tmp_path / "x", notes)
    said = Page(page([shown(folder=folder)], [])).text
    assert f"sixthsense replay '/logs/my log.clf' --config {folder}/config.toml --relations r.txt" in said


def test_the_commands_of_a_run_with_a_prior_map_have_its_options(tmp_path):
    notes = "[prior_map]\nname = 'the first'\ndigest = 'ab'\npose = [1.0, 2.0, 0.5]\npose_sigma = [0.1, 0.1, 0.0]\n"
    folder = noted(tmp_path / "x", notes)
    said = Page(page([shown(folder=folder)], [])).text
    options = "--prior-map 'the first' --pose 1.0 2.0 0.5 --pose-sigma 0.1 0.1 0.0"
    assert f"sixthsense run --config {folder}/config.toml {options}" in said
    assert f"sixthsense replay {folder} {options}" in said


@pytest.mark.parametrize("notes", ["", "[[", "replayed = 3", "[replayed]", "versions = []", "prior_map = 3"])
def test_invalid_notes_are_ignored(tmp_path, notes):
    folder = noted(tmp_path / "x", notes)
    assert f"sixthsense run --config {folder}/config.toml" in Page(page([shown(folder=folder)], [])).text


def test_the_page_of_a_killed_run_says_so(folder, tmp_path, capsys):
    killed = tmp_path / "two.partial"
    (killed / "bag").mkdir(parents=True)
    for name in ("config.toml", "bag/bag_0.mcap"):
        (killed / name).write_bytes((folder / name).read_bytes())
    assert main(["report", str(killed)]) == 0
    said = Page((killed / "figures" / "report.html").read_text(encoding="utf-8")).text
    assert "interrupted" in said
    assert "stopped before its end" in said
    assert "wall_time_s" not in said


@pytest.mark.parametrize("form", ["svg", "pdf"])
def test_vector_figures_are_the_same_each_time(folder, tmp_path, form, monkeypatch):
    monkeypatch.setattr("sixthsense.figures.report.KINDS", ("map", "nees"))
    run = load(folder)
    first = {file.name: file.read_bytes() for file in report([run], tmp_path / "a", form)}
    again = {file.name: file.read_bytes() for file in report([run], tmp_path / "b", form)}
    vectors = {name for name in first if name.endswith(form)}
    assert vectors == {name.replace("png", form) for name in first if name.endswith("png")}
    for name in vectors:
        assert first[name] == again[name]
        assert first[name].startswith(b"<?xml" if form == "svg" else b"%PDF")


def test_a_run_without_a_folder_has_a_page(tmp_path, folder):
    run = load(folder)
    report([Run("here", run.trace, run.metrics)], tmp_path)
    assert "--config" not in Page((tmp_path / "report.html").read_text(encoding="utf-8")).text


def test_an_unknown_format_is_refused_in_one_line(folder, capsys):
    assert main(["report", str(folder), "--figures", "bmp"]) == 2
    assert capsys.readouterr().err == "sixthsense: --figures: found 'bmp', allowed: png, svg, pdf\n"
