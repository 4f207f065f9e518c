"""Reports on runs: their figures, the page, the command, and films."""

import csv
import dataclasses
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sixthsense.cli import main
from sixthsense.config import preset
from sixthsense.evaluation.results import Metrics
from sixthsense.figures import animation
from sixthsense.figures.kinds import KINDS
from sixthsense.figures.report import report
from sixthsense.figures.run import Run, load
from sixthsense.record.trace import Trace

PAGE = "report.html"
PICTURES = {f"{name}.png" for name in KINDS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one"
    drive = ["--task", "tour", "--max-time", "12", "--seed", "2", "--estimator", "ekf"]
    assert main(["run", "rectangle", *drive, "--out", str(out)]) == 0
    assert main(["report", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def text(folder) -> str:
    return (folder / "figures" / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def finished(explored) -> Run:
    return Run("rectangle-1", explored.trace)


def shown(name: str = "a", metrics=None, folder: Path | None = None, **fields) -> Run:
    trace = Trace(preset(**fields), None, 0.2, outcome="explored")
    return Run(name, trace, Metrics(metrics or {"ate_rmse_m": 1.0}), folder)


def noted(folder: Path, notes: str) -> Path:
    """A run's folder of which there is no more than what its configuration notes."""
    folder.mkdir()
    (folder / "config.toml").write_text(notes, encoding="utf-8")
    return folder


def without_truth(run: Run) -> Run:
    trace = dataclasses.replace(run.trace, scene=None, truths=[], key_truths=[])
    return Run("log", trace)


def test_several_runs_are_shown_side_by_side_with_a_table(finished, tmp_path):
    files = report([finished, without_truth(finished)], tmp_path)
    assert {file.name for file in files} == PICTURES | {"metrics.csv", PAGE}
    for name in PICTURES:
        with Image.open(tmp_path / name) as image:
            image.load()
            assert image.size[0] > 600
    with (tmp_path / "metrics.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["metric"]: row for row in csv.DictReader(file)}
    assert float(rows["ate_rmse_m"]["rectangle-1"]) == finished.metrics["ate_rmse_m"]  # all digits
    assert rows["ate_rmse_m"]["log"] == ""
    assert rows["outcome"]["log"] == "explored"


def test_the_command_writes_into_the_folder_of_one_run_and_into_another_only_on_request(folder, tmp_path, capsys):
    written = {file.name for file in (folder / "figures").iterdir()}
    assert written == PICTURES - {"exploration.png"} | {PAGE}  # a tour explores nothing
    assert main(["report", str(folder), "--out", str(tmp_path)]) == 2
    assert "exists, allowed: a new folder, or --overwrite" in capsys.readouterr().err
    assert main(["report", str(folder), "--out", str(tmp_path), "--overwrite"]) == 0
    assert (tmp_path / "map.png").is_file()
    assert "ate_rmse_m" in capsys.readouterr().out


def test_the_page_needs_no_other_files(text):
    loading = [value for value in re.findall(r' (?:src|href|srcset|data|action)="([^"]*)"', text) if value[0] != "#"]
    assert loading and all(value.startswith("data:image/png;base64,") for value in loading)
    assert re.search(r"url\(|@import|https?:|<script|<link|<iframe|<object", text) is None


def test_every_external_text_is_escaped(tmp_path):
    nasty = '<b onload="x">&amp;'
    quoted = json.dumps(nasty)
    notes = f"[versions]\n{quoted} = {quoted}\n[replayed]\nlog = {quoted}\n{quoted} = {quoted}\n"
    run = shown(nasty, {"outcome": nasty, nasty: nasty}, noted(tmp_path / "one", notes), scene=nasty)
    for k, runs in enumerate(([run], [run, shown()])):
        report(runs, tmp_path / f"{k}")
        text = (tmp_path / f"{k}" / PAGE).read_text(encoding="utf-8")
        assert "<b " not in text and nasty in html.unescape(text)


def test_a_page_says_the_verdicts_of_a_run_first_in_the_words_of_its_summary(folder, text):
    run, plain = load(folder), html.unescape(text)
    places = [plain.index(run.summary[label]) for label in ("outcome", "map", "consistency", "accuracy", "speed")]
    assert places == sorted(places) and run.summary["consistency"] in str(run) and run.summary["map"] in repr(run)


def test_a_film_has_the_given_number_of_frames_and_the_map_grows(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "_HELD", 2)  # frames at the end, each of which takes its time
    shown, trace = [], load(folder).trace
    animation.animate(folder, trace, tmp_path / "run.gif", "a run", frames=3, on_frame=lambda: shown.append(1))
    assert len(shown) == 3
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames == 3
        frames = []
        for k in range(3):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), dtype=np.int64))
    assert np.abs(frames[2] - frames[0]).max() > 50
