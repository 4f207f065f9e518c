import csv
import dataclasses
from pathlib import Path

import pytest
from PIL import Image

from sixthsense.cli import main
from sixthsense.figures.report import report
from sixthsense.figures.run import Run, load

PAGE = "report.html"
KINDS = {"map.png", "error.png", "rpe.png", "nees.png", "nis.png", "stages.png", "coverage.png", "exploration.png"}


@pytest.fixture
def finished(explored) -> Run:
    return Run("rectangle-1", explored.trace)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one"
    assert main(["run", "rectangle", "--seed", "2", "--out", str(out)]) == 0
    return out


def without_truth(run: Run) -> Run:
    trace = dataclasses.replace(run.trace, scene=None, truths=[], key_truths=[])
    return Run("log", trace)


def test_one_run_has_a_figure_of_each_kind(finished, tmp_path):
    files = report([finished], tmp_path / "deep" / "figures")
    assert {file.name for file in files} == KINDS | {PAGE}
    for file in files[:-1]:
        with Image.open(file) as image:
            image.load()
            assert image.size[0] > 800


def test_several_runs_are_shown_side_by_side_with_a_table(finished, tmp_path):
    files = report([finished, without_truth(finished)], tmp_path)
    assert {file.name for file in files} == KINDS | {"metrics.csv", PAGE}
    with (tmp_path / "metrics.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["metric"]: row for row in csv.DictReader(file)}
    assert float(rows["ate_rmse_m"]["rectangle-1"]) == finished.metrics["ate_rmse_m"]  # all digits
    assert rows["ate_rmse_m"]["log"] == ""
    assert rows["outcome"]["log"] == "explored"


def test_a_run_without_truth_has_no_figures_that_need_it(finished, tmp_path):
    files = report([without_truth(finished)], tmp_path)
    assert {file.name for file in files} == {"map.png", "nis.png", "stages.png", "exploration.png", PAGE}


def test_a_killed_run_is_reported_without_its_end(folder, tmp_path):
    killed = tmp_path / "two.partial"
    killed.mkdir()
    (killed / "config.toml").write_bytes((folder / "config.toml").read_bytes())
    lines = (folder / "record.jsonl").read_bytes().splitlines(keepends=True)
    (killed / "record.jsonl").write_bytes(b"".join(lines[:-1]))
    loaded = load(killed)
    assert loaded.name == "two"
    assert loaded.metrics["outcome"] == "interrupted" and "wall_time_s" not in loaded.metrics
    assert main(["report", str(killed)]) == 0
    assert (killed / "figures" / "error.png").is_file()


def test_the_command_writes_into_the_folder_of_one_run(folder, capsys):
    assert main(["report", str(folder)]) == 0
    assert {file.name for file in (folder / "figures").iterdir()} == KINDS - {"rpe.png"} | {
        PAGE
    }  # too short a drive for relative errors
    assert "ate_rmse_m" in capsys.readouterr().out


def test_an_existing_folder_is_overwritten_only_on_request(folder, tmp_path, capsys):
    assert main(["report", str(folder), "--out", str(tmp_path)]) == 2
    assert "exists, allowed: a new folder, or --overwrite" in capsys.readouterr().err
    assert main(["report", str(folder), "--out", str(tmp_path), "--overwrite"]) == 0
    assert (tmp_path / "map.png").is_file()
