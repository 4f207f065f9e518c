"""Every table of README.md and of the page of results is that of a file of results."""

import importlib
import re
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
MOST_COMMANDS = 16


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


def test_there_are_few_commands_and_the_pages_name_no_other():
    files = {path.name: path.read_text(encoding="utf-8") for path in BENCHMARKS.glob("*.py")}
    commands = {name for name, text in files.items() if "\ndef main(" in text}
    assert len(commands) <= MOST_COMMANDS
    page = (BENCHMARKS / "RESULTS.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\b(\w+\.py)\b", page)) <= {*commands, "tables.py"}


def test_readme_pages_and_notebooks_name_only_benchmarks_that_are_there():
    root = BENCHMARKS.parent
    pages = [root / "README.md", root / "CONTRIBUTING.md", *root.glob("docs/**/*.md"), *root.glob("notebooks/*.ipynb")]
    named = {
        (page.name, found) for page in pages for found in re.findall(r"benchmarks/(\w+\.py)", page.read_text("utf-8"))
    }
    assert named and not [each for each in sorted(named) if not (BENCHMARKS / each[1]).is_file()]
