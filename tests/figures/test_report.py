import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sixthsense.cli import main
from sixthsense.evaluation.measured_run import ReportError, check_folders
from sixthsense.figures.report import compact, report, table
from sixthsense.figures.run import Run, load

PAGE = "report.html"
KINDS = {"map.png", "error.png", "nees.png", "nis.png", "stages.png", "coverage.png", "exploration.png"}


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


def test_an_exploration_has_its_title_right_above_its_plane(finished, tmp_path):
    report([finished], tmp_path)
    with Image.open(tmp_path / "exploration.png") as image:
        rows = (np.asarray(image.convert("L")) < 128).any(axis=1)
    marked = np.flatnonzero(rows)
    assert np.diff(marked[: np.count_nonzero(marked < len(rows) // 2)]).max() < 40


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


def test_runs_of_the_same_name_are_distinguished(finished):
    assert table([finished, finished])[0] == ["metric", "rectangle-1 (1)", "rectangle-1 (2)"]


def test_the_printed_table_has_four_digits_and_whole_counts(finished):
    text = compact([["metric", "a"], ["ate", "0.123456"], ["many", "123456"], ["outcome", "stuck"], ["none", ""]])
    assert text.splitlines() == ["metric   a", "ate      0.1235", "many     123456", "outcome  stuck", "none"]


@pytest.mark.parametrize("count", [0, 13])
def test_too_few_or_too_many_runs_are_refused(finished, tmp_path, count):
    with pytest.raises(ReportError, match=f"found {count}, allowed: 1 to 12"):
        report([finished] * count, tmp_path / "out")
    with pytest.raises(ReportError, match=f"found {count}, allowed: 1 to 12"):
        check_folders([tmp_path] * count)


def test_a_folder_is_read_with_the_metrics_of_its_run(folder):
    loaded = load(folder)
    assert loaded.metrics == json.loads((folder / "metrics.json").read_text())
    assert loaded.name == "one"
    assert "rectangle" in loaded.title
    assert "explored" in loaded.title


def test_a_killed_run_is_reported_without_times(folder, tmp_path):
    killed = tmp_path / "two.partial"
    killed.mkdir()
    (killed / "config.toml").write_bytes((folder / "config.toml").read_bytes())
    (killed / "bag").mkdir()
    bag = (folder / "bag" / "bag_0.mcap").read_bytes()
    (killed / "bag" / "bag_0.mcap").write_bytes(bag)
    loaded = load(killed)
    assert loaded.name == "two"
    assert loaded.metrics["outcome"] == "interrupted"
    assert not any("_ms" in key or key == "wall_time_s" for key in loaded.metrics)
    assert main(["report", str(killed)]) == 0
    assert not (killed / "figures" / "stages.png").exists()
    assert (killed / "figures" / "error.png").is_file()


def test_the_command_writes_into_the_folder_of_one_run(folder, capsys):
    assert main(["report", str(folder)]) == 0
    assert {file.name for file in (folder / "figures").iterdir()} == KINDS | {PAGE}
    assert "ate_rmse_m" in capsys.readouterr().out


def test_the_command_writes_several_runs_into_runs(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        assert main(["report", str(folder), str(folder)]) == 0
        assert (tmp_path / "runs" / f"report-{number}" / "metrics.csv").is_file()
    assert "one (1)" in capsys.readouterr().out


def test_an_existing_folder_is_overwritten_only_on_request(folder, tmp_path, capsys):
    assert main(["report", str(folder), "--out", str(tmp_path)]) == 2
    assert "exists, allowed: a new folder, or --overwrite" in capsys.readouterr().err
    assert main(["report", str(folder), "--out", str(tmp_path), "--overwrite"]) == 0
    assert (tmp_path / "map.png").is_file()


@pytest.mark.parametrize(
    ("args", "complaint"),
    [
        (["report"], "run: found nothing, allowed: folders of runs, or of a campaign"),
        (["report", "nowhere"], "nowhere: found no such folder, allowed: the folder of a run or of a campaign"),
        (["report", "."], ".: found no config.toml in it, allowed: the folder of a run or of a campaign"),
        (["report", "x", "--beams", "3"], "--beams: no such option, allowed: --out, --overwrite, --figures, --animate"),
        (["report", "x", "--out"], "--out: found nothing, allowed: 1 value"),
    ],
)
def test_a_folder_without_a_run_is_refused_in_one_line(args, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(args) == 2
    assert capsys.readouterr().err == f"sixthsense: {complaint}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"ate_rmse_m": "far"}', '{"outcome": 3}', "[" * 100_000, '{"a": null}']
)
def test_invalid_metrics_are_refused_in_one_line(folder, tmp_path, text, capsys):
    broken = tmp_path / "broken"
    (broken / "bag").mkdir(parents=True)
    for name in ("config.toml", "bag/bag_0.mcap"):
        (broken / name).write_bytes((folder / name).read_bytes())
    (broken / "metrics.json").write_text(text)
    assert main(["report", str(broken)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("sixthsense: ")
    assert err.count("\n") == 1
    assert "metrics.json: " in err
    assert not (broken / "figures").exists()


def test_help_lists_the_options_of_the_command(capsys):
    assert main(["report", "--help"]) == 0
    assert "usage: sixthsense report RUN_DIR ..." in capsys.readouterr().out
