"""The suite of measurements: figures over runs, what is asked of them, what is worse, and the tables of the pages."""

import importlib
import math
import re
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def suite(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("suite")


@pytest.fixture
def column(suite):
    return suite.Column


VALUES = {"m": [1.0, 4.0, None, 7.0], "n": [2.0, 2.0], "none": [None]}


@pytest.mark.parametrize(
    ("figure", "value", "error"),
    [("m", 4.0, math.sqrt(3.0)), ("m max", 7.0, None), ("m sum", 12.0, None), ("m / n", 3.0, None)],
)
def test_a_figure_over_runs_leaves_out_those_that_did_not_measure_it(suite, figure, value, error):
    found, its_error = suite.over_runs(figure, VALUES)
    assert found == pytest.approx(value)
    assert its_error == (None if error is None else pytest.approx(error))


@pytest.mark.parametrize("figure", ["none", "other", "none max", "m / none"])
def test_a_figure_that_no_run_measured_is_no_number_and_an_empty_cell(suite, column, figure):
    assert math.isnan(suite.over_runs(figure, VALUES)[0])
    assert suite.cell(column("", figure, ".1f", ">= 9"), VALUES) == ""


@pytest.mark.parametrize(
    ("asked", "value", "is_met"),
    [
        ("<= 0.5", 0.5, True), ("<= 0.5", 0.51, False), (">= 0.9", 0.9, True), (">= 0.9", 0.89, False),
        ("2.4 to 3.9", 2.4, True), ("2.4 to 3.9", 3.9, True), ("2.4 to 3.9", 2.3, False), ("2.4 to 3.9", 4.0, False),
        ("", 99.0, True),
    ],
)  # fmt: skip
def test_limits_hold_where_they_are_met_exactly(suite, column, asked, value, is_met):
    assert suite.is_met(asked, value) == is_met
    assert suite.cell(column("", "x", ".2f", asked), {"x": [value]}).startswith("**") == (not is_met)


def row(values, outcomes=("explored",)):
    return {"seeds": [*range(len(values))], "outcomes": [*outcomes], "values": {"x": [*values]}}


RECORDED = (3.0, 3.4, 2.6, 3.2, 2.8)


@pytest.mark.parametrize(("off", "is_worse"), [(0.0, False), (0.3, False), (1.5, True), (-1.5, False)])
def test_a_figure_is_worse_if_it_left_what_is_asked_by_more_than_its_spread_explains(suite, column, off, is_worse):
    columns = [column("x", "x", ".2f", "<= 2")]
    found = suite.worse_than(columns, row(RECORDED), row([value + off for value in RECORDED[:3]]))
    assert bool(found) == is_worse
    assert not suite.worse_than([column("x", "x", ".2f")], row(RECORDED), row([99.0])), "nothing is asked of it"


@pytest.mark.parametrize(("value", "is_worse"), [(1.09, False), (1.12, True), (0.5, False)])
def test_of_one_run_a_tenth_is_allowed(suite, column, value, is_worse):
    assert bool(suite.worse_than([column("x", "x", ".2f", "<= 0")], row([1.0]), row([value]))) == is_worse


def test_an_outcome_that_no_run_had_is_worse(suite):
    assert suite.worse_than([], row([1.0]), row([1.0], ["stuck"])) == ["found outcome stuck"]
    assert not suite.worse_than([], row([1.0], ["explored", "stuck"]), row([1.0], ["stuck"]))


def test_a_row_has_a_figure_for_each_seed(suite, monkeypatch):
    monkeypatch.setattr(suite, "git", lambda *words: "abc")
    case = suite.Case("explore", ("rectangle",))
    runs = [{"key": "a", "outcome": "explored", "coverage": 1 / 3}, {"key": "b", "outcome": "explored"}]
    found = suite.collected(case, runs, "tree")
    assert found["values"] == {"coverage": [0.333333, None]} and found["outcomes"] == ["explored"] * 2
    assert found["commit"] == "abc" and found["package"] == "tree"


def test_cases_have_names_of_their_own_and_rows_are_of_cases(suite):
    names = [case.name for case in suite.CASES]
    assert len({*names}) == len(names)
    assert {*suite.recorded()} <= {*names}


def test_runs_are_kept_so_that_an_interrupted_command_goes_on(suite, monkeypatch, tmp_path):
    case = suite.Case("audit", ("white", "SE(2)", "1"))
    monkeypatch.setattr(suite, "CACHE", tmp_path)
    monkeypatch.setattr(suite, "package_tree", lambda: "tree")
    kept = suite.Rows(tmp_path / "tree.jsonl")
    for seed in (4, 5):
        kept.add({"key": f"{case.name}#{seed}", "factor": float(seed)})
    made, failed = suite.measured({case: [4, 5]}, 0.0, 1)
    assert [run["factor"] for run in made[case]] == [4.0, 5.0] and not failed
    assert suite.measured({case: [4, 5, 6]}, 0.0, 1) == ({}, []), "the time is over, and a run is missing"


def test_the_tables_of_the_pages_are_those_of_the_rows(suite):
    rows = suite.recorded()
    for page in suite.PAGES:
        text = page.read_text(encoding="utf-8")
        assert suite.written(text, rows) == text, "run `python benchmarks/suite.py --tables`"


def test_text_outside_the_markers_stays_and_a_marker_of_no_table_is_refused(suite):
    begin, end = "<!-- table: odd -->", "<!-- end of odd -->"
    page = suite.written(f"a\n{begin}\nold\n{end}\nb", {})
    assert page == f"a\n{begin}\n\nNot measured.\n\n{end}\nb" == suite.written(page, {})
    for wrong in (f"{begin}\nold", "<!-- table: even -->\n<!-- end of even -->"):
        with pytest.raises(ValueError, match=r"markers: found '(odd|even)', allowed: headline"):
            suite.written(wrong, {})


def test_every_row_has_its_place_on_a_page(suite):
    pages = "".join(page.read_text(encoding="utf-8") for page in suite.PAGES)
    placed = {*re.findall(r"<!-- table: (.+?) -->", pages)} - {"headline", "beside others"}
    assert placed == {name.partition(".")[0] for name in suite.recorded()}


def test_a_table_has_a_line_of_all_runs_where_it_is_asked_for(suite):
    cases = [case for case in suite.CASES if case.kind == "world"][:2]
    rows = {case.name: row([2.0, 4.0]) | {"commit": "c", "machine": "m"} for case in cases}
    for one, nees in zip(rows.values(), ([2.0, 4.0], [5.0, 7.0]), strict=True):
        one["values"] = {"nees": nees}
    last = [line for line in suite.table_of("world", rows).splitlines() if line.startswith("| all")]
    error = np.std([2.0, 4.0, 5.0, 7.0], ddof=1) / 2.0
    assert last and f"{4.5:.2f} ± {error:.2f}" in last[0] and "| 4 |" in last[0]


def test_readme_pages_and_notebooks_name_only_benchmarks_that_are_there():
    root = BENCHMARKS.parent
    pages = [root / "README.md", root / "CONTRIBUTING.md", *root.glob("docs/**/*.md"), *root.glob("notebooks/*.ipynb")]
    named = {
        (page.name, found) for page in pages for found in re.findall(r"benchmarks/(\w+\.py)", page.read_text("utf-8"))
    }
    assert named and not [each for each in sorted(named) if not (BENCHMARKS / each[1]).is_file()]
