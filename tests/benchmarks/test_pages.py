"""Every table of README.md and of the pages of results is that of a file of results."""

import importlib
import re
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("tables")


def test_the_tables_of_the_pages_are_those_of_the_files(tables):
    known = tables.texts()
    for page in tables.PAGES:
        text = page.read_text(encoding="utf-8")
        assert tables.written(text, known) == text, "run `python benchmarks/tables.py`"


def test_a_name_without_a_file_is_an_error_and_text_outside_the_markers_stays(tables):
    begin, end = tables.markers("readme")
    assert tables.written(f"a\n{begin}\nold\n{end}\nb", {"readme": "new"}) == f"a\n{begin}\n\nnew\n\n{end}\nb"
    with pytest.raises(ValueError, match="found 'readme', allowed: results"):
        tables.written(f"{begin}\n{end}", {"results": "new"})


def test_every_table_has_its_place_on_a_page(tables):
    placed = {name for page in tables.PAGES for name in tables.MARKER.findall(page.read_text(encoding="utf-8"))}
    # The ratios of the kernels are part of those of `bench`; the evidence keeps them for the guard.
    assert placed == set(tables.texts()) - {"kernels"}


def test_readme_pages_and_notebooks_name_only_benchmarks_that_are_there():
    root = BENCHMARKS.parent
    pages = [root / "README.md", root / "CONTRIBUTING.md", *root.glob("docs/**/*.md"), *root.glob("notebooks/*.ipynb")]
    named = {
        (page.name, found) for page in pages for found in re.findall(r"benchmarks/(\w+\.py)", page.read_text("utf-8"))
    }
    assert named and not [each for each in sorted(named) if not (BENCHMARKS / each[1]).is_file()]
