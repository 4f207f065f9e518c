"""The headline tables are those of evidence.json, and the guard tells a worse figure from one that varies."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark as a script is: its folder first on the path."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return importlib.import_module


@pytest.fixture
def recorded():
    return json.loads((REPOSITORY / "benchmarks" / "evidence.json").read_text())


@pytest.mark.parametrize(("name", "page"), [("readme", "README.md"), ("results", "benchmarks/RESULTS.md")])
def test_the_tables_of_a_page_are_those_of_the_evidence(script, recorded, name, page):
    tables = script("evidence_tables")
    begin, end = tables.markers(name)
    text = (REPOSITORY / page).read_text(encoding="utf-8").split(begin)[1].split(end)[0]
    assert text.strip() == tables.rendered(recorded)[name], "run `python benchmarks/evidence.py --render`"


def test_the_evidence_has_every_row_with_a_value_for_each_seed_and_the_commit_of_its_code(script, recorded):
    rows = script("evidence_rows")
    assert set(recorded["rows"]) == {row.key for row in rows.ROWS}
    for row in rows.ROWS:
        own = recorded["rows"][row.key]
        assert own["commit"]
        assert all(seed >= 1000 for seed in own["seeds"]) or row.kind in ("relations", "mrclam", "victoria", "kernels")
        if set(own["outcomes"]) != {"rejected"}:
            assert {figure.name for figure in rows.FIGURES[row.kind]} <= set(own["values"])
        assert all(len(values) == len(own["seeds"]) for values in own["values"].values())
        assert len(own["outcomes"]) in (0, len(own["seeds"]))


def test_a_cell_is_the_mean_and_its_standard_error_over_runs(script):
    tables, figure = script("evidence_tables"), script("evidence_rows").FIGURES["tour"][0]
    assert tables.cell(figure, {"values": {"nees": [2.0, 3.0, 4.0, 3.0]}}) == "3.00 ± 0.41"
    assert tables.cell(figure, {"values": {"nees": [2.5]}}) == "2.50"
    assert tables.cell(figure, {"values": {"nees": [None]}}) == tables.cell(figure, {"values": {}}) == ""


def test_a_page_without_markers_is_an_error_and_text_outside_them_stays(script):
    tables = script("evidence_tables")
    begin, end = tables.markers("readme")
    assert tables.placed(f"a\n{begin}\nold\n{end}\nb", "readme", "new") == f"a\n{begin}\n\nnew\n\n{end}\nb"
    with pytest.raises(ValueError, match="markers: found none of 'readme'"):
        tables.placed("a page", "readme", "new")


def test_a_run_is_measured_once_for_each_state_of_the_code(script, tmp_path, monkeypatch):
    evidence, rows = script("evidence"), script("evidence_rows")
    calls = []

    def count(setting, seed):
        calls.append(seed)
        return {"outcome": "tour ended", "nees": 3.0 + seed}

    monkeypatch.setitem(rows.KINDS, "tour", count)
    monkeypatch.setattr(evidence, "CACHE", tmp_path)
    monkeypatch.setattr(evidence, "warm_up", lambda: None)
    row = rows.Row("tour", ("office", "ekf"), 20)
    for _ in range(2):
        made = evidence.measure_rows([row], 0.1, 1, "abc")
    assert calls == [1000, 1001]
    assert made["tour.office.ekf"]["values"] == {"nees": [1003.0, 1004.0]}
    assert made["tour.office.ekf"]["outcomes"] == ["tour ended"] * 2
    evidence.measure_rows([row], 0.1, 1, "abd")
    assert len(calls) == 4


def test_the_json_is_read_back_as_it_was_written(script, recorded):
    assert json.loads(script("evidence").as_json(recorded)) == recorded


def test_a_tour_has_all_figures_of_its_row(script, monkeypatch):
    rows = script("evidence_rows")
    monkeypatch.setattr(rows, "TOUR_S", 8.0)
    figures = rows.tour_figures(("apartment", "ekf-invariant"), 1000)
    assert set(figures) == {"outcome", *(figure.name for figure in rows.FIGURES["tour"])}
    assert figures["outcome"] == "tour ended"
    assert figures["wrong_per_1000"] == 0.0
    assert all(np.isfinite(value) for name, value in figures.items() if name != "outcome")


def test_an_exploration_has_all_figures_of_its_row(script):
    rows = script("evidence_rows")
    figures = rows.explore_figures(("rectangle",), 1000)
    assert set(figures) == {"outcome", *(figure.name for figure in rows.FIGURES["explore"])}
    assert figures["outcome"] == "explored"


@pytest.mark.parametrize(
    ("best", "recorded", "now", "is_worse"),
    [
        (3.0, [2.0, 3.0, 4.0, 3.0], [2.0, 3.0], False),  # as recorded
        (3.0, [2.0, 3.0, 4.0, 3.0], [4.0, 4.5], False),  # within three standard errors
        (3.0, [2.0, 3.0, 4.0, 3.0], [6.0, 6.5], True),
        (3.0, [2.0, 3.0, 4.0, 3.0], [0.2, 0.3], True),  # too small is worse, too
        (3.0, [6.0, 7.0, 6.0, 7.0], [3.0, 3.0], False),  # nearer to the best value
        ("low", [0.0, 0.0, 0.0], [0.0, 0.1], True),  # never seen before
        ("high", [0.99, 0.99, 0.99], [1.0, 1.0], False),
        ("high", [10.0], [9.5], False),  # one run: a tenth
        ("high", [10.0], [8.5], True),
    ],
)  # fmt: skip
def test_a_figure_is_worse_beyond_what_its_spread_explains(script, best, recorded, now, is_worse):
    figure = script("evidence_rows").Figure("some", "some", ".2f", best)
    assert script("guard").compared("row", figure, recorded, now).is_worse is is_worse


def test_an_outcome_that_no_recorded_run_had_is_worse(script):
    guard, rows = script("guard"), script("evidence_rows")
    row = rows.Row("explore", ("office",), 2)
    recorded = {"values": {"coverage": [1.0, 1.0]}, "outcomes": ["explored", "explored"]}
    same, other = ([{"outcome": name, "coverage": 1.0}] for name in ("explored", "out of time"))
    assert not any(found.is_worse for found in guard.comparisons(row, recorded, same))
    assert [found.title for found in guard.comparisons(row, recorded, other) if found.is_worse] == ["outcome"]


def test_the_guard_ends_with_1_where_a_figure_is_worse_and_with_0_where_none_is(script, tmp_path, monkeypatch, capsys):
    guard, rows = script("guard"), script("evidence_rows")
    monkeypatch.setattr("sys.argv", ["guard.py", "--jobs", "1"])
    file = tmp_path / "evidence.json"
    monkeypatch.setattr(guard, "JSON", file)
    assert guard.main({"tour.office.ekf": 2}) == 2
    recorded = {"seeds": [1000, 1001, 1002], "outcomes": ["tour ended"] * 3, "values": {"ate_m": [0.01, 0.02, 0.03]}}
    file.write_text(json.dumps({"rows": {"tour.office.ekf": recorded}}))
    for ate, code in ((0.02, 0), (0.2, 1)):
        monkeypatch.setitem(rows.KINDS, "tour", lambda *_, ate=ate: {"outcome": "tour ended", "ate_m": ate})
        assert guard.main({"tour.office.ekf": 2}) == code
    assert "WORSE" in capsys.readouterr().out
