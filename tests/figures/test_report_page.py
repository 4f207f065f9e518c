import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from sixthsense.cli import main
from sixthsense.config import preset
from sixthsense.evaluation.results import Metrics
from sixthsense.figures.panels import KINDS
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
        text = page(runs, {})
        parsed = Page(text)
        assert "b" not in parsed.tags
        assert "<b " not in text
        assert nasty in parsed.text


def test_several_runs_have_a_column_each_and_only_the_settings_that_differ():
    one = shown("one", {"ate_rmse_m": 0.25, "plans": 3}, seed=1, estimator="isam2")
    two = shown("two", {"ate_rmse_m": 0.5, "outcome": "stuck"}, seed=2, estimator="isam2")
    text = page([one, two], {})
    said = Page(text).text
    assert "Runs compared: one, two" in said
    assert "two: stuck" in said
    changed = said.partition("different field")[2].partition("Complete configuration")[0]
    assert "seed12" in changed
    assert "estimator" not in changed


@pytest.mark.parametrize("form", ["svg"])
def test_vector_figures_are_the_same_each_time(folder, tmp_path, form, monkeypatch):
    monkeypatch.setattr("sixthsense.figures.report.KINDS", {name: KINDS[name] for name in ("map", "nees")})
    run = load(folder)
    first = {file.name: file.read_bytes() for file in report([run], tmp_path / "a", form)}
    again = {file.name: file.read_bytes() for file in report([run], tmp_path / "b", form)}
    vectors = {name for name in first if name.endswith(form)}
    assert vectors == {name.replace("png", form) for name in first if name.endswith("png")}
    for name in vectors:
        assert first[name] == again[name]
        assert first[name].startswith(b"<?xml" if form == "svg" else b"%PDF")
