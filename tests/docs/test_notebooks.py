"""The notebooks as they are committed; `make notebooks` runs them."""

import ast
import importlib
import importlib.util
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
MOST_BYTES = 400_000
PUBLIC_ROOMS = ("sixthsense", "sixthsense.figures", "sixthsense.testing")
"""whose `__all__` is public"""
REFERENCE = (Path(__file__).parents[2] / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
LISTED = frozenset(re.findall(r"^::: ([\w.]+)$", REFERENCE, re.MULTILINE))
"""names and modules of the page of the public interface"""
# Folders of one's own, of a temporary file, and of Windows.
PLACE = re.compile(r"(/home/|/Users/|/root/|/tmp/|/var/folders/|/dev/shm|/work/|[A-Za-z]:\\\\)[\w.~-]*")


@pytest.fixture(params=NOTEBOOKS, ids=lambda file: str(file.stem))
def notebook(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def code_cells(file: Path) -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def shown_texts(cell: dict[str, Any]) -> list[str]:
    """What a cell shows, but for the content of its pictures."""
    texts = []
    for output in cell["outputs"]:
        texts.append("".join(output.get("text", "")))
        for kind, content in output.get("data", {}).items():
            if not kind.startswith("image/"):
                texts.append(json.dumps(content) if isinstance(content, dict) else "".join(content))
    return texts


def test_a_notebook_was_run_from_top_to_bottom(notebook: Path) -> None:
    cells = code_cells(notebook)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))


def test_a_notebook_shows_pictures_and_no_error(notebook: Path) -> None:
    outputs = [output for cell in code_cells(notebook) for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]


def test_a_notebook_shows_no_place_of_the_machine_that_ran_it(notebook: Path) -> None:
    texts = [text for cell in code_cells(notebook) for text in shown_texts(cell)]
    # What is drawn inside a text, such as a card's map, has letters of every kind.
    words = [re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]*", "", text) for text in texts]
    assert not [match.group() for text in words for match in PLACE.finditer(text)]


def test_a_notebook_is_small_enough_to_be_kept_in_every_version(notebook: Path) -> None:
    assert notebook.stat().st_size < MOST_BYTES


def package_names(notebook: Path) -> Iterator[str]:
    """Full names of what a notebook takes from the package, by imports and as attributes of imported modules."""
    modules: dict[str, str] = {}
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        texts = [source] if cell["cell_type"] == "code" else re.findall(r"^```python\n(.*?)^```$", source, re.M | re.S)
        for text in texts:
            tree = ast.parse(re.sub(r"^( *)%.*", r"\1pass", text, flags=re.MULTILINE))
            for node in ast.walk(tree):
                if isinstance(node, ast.Import):
                    modules |= {one.asname or one.name: one.name for one in node.names if is_ours(one.name)}
                elif isinstance(node, ast.ImportFrom) and is_ours(node.module or ""):
                    for one in node.names:
                        full = f"{node.module}.{one.name}"
                        modules |= {one.asname or one.name: full} if is_module(full) else {}
                        yield from [] if is_module(full) else [full]
                elif isinstance(node, ast.Attribute) and (full := dotted(node, modules)) and not is_module(full):
                    yield from [full] if is_module(full.rpartition(".")[0]) else []


def dotted(node: ast.expr, modules: dict[str, str]) -> str:
    """The full name of an attribute of a module of the package, or of one in it; empty for any other expression."""
    if isinstance(node, ast.Name):
        return modules.get(node.id, "")
    inner = dotted(node.value, modules) if isinstance(node, ast.Attribute) else ""
    return f"{inner}.{node.attr}" if inner and isinstance(node, ast.Attribute) else ""


def is_ours(name: str) -> bool:
    return name.split(".")[0] == "sixthsense"


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def is_public(name: str) -> bool:
    """Whether a name stands on the page of the interface, alone or with its module, or in a public room's `__all__`."""
    module, _, last = name.rpartition(".")
    if any(part.startswith("_") for part in name.split(".")):
        return False
    return (
        name in LISTED
        or module in LISTED
        or (module in PUBLIC_ROOMS and last in importlib.import_module(module).__all__)
    )


def test_a_notebook_uses_public_names_alone(notebook: Path) -> None:
    names = set(package_names(notebook))
    assert names and [name for name in sorted(names) if not is_public(name)] == []


@pytest.mark.parametrize(
    "name",
    ["sixthsense.slam.association.associator.Associator", "sixthsense.figures._axes", "sixthsense.core.se2.whitening"],
)
def test_what_is_in_a_room_is_not_public_for_that(name: str) -> None:
    assert not is_public(name)


def test_names_of_a_notebook_are_found_however_they_are_written(tmp_path: Path) -> None:
    source = """import sixthsense as ss
from sixthsense import figures as fig
from sixthsense.core.se2 import whitening
ss.run().plot(fig.ellipse, ss.slam.slam.Slam)
%pip install nothing
"""
    file = tmp_path / "one.ipynb"
    file.write_text(json.dumps({"cells": [{"cell_type": "code", "source": [source]}]}))
    found = [
        "sixthsense.core.se2.whitening",
        "sixthsense.figures.ellipse",
        "sixthsense.run",
        "sixthsense.slam.slam.Slam",
    ]
    assert sorted(package_names(file)) == found


def test_the_report_is_linked_where_it_is_named(notebook: Path) -> None:
    """To the page that says what it is, and to a heading that is there."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    page = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    headings = {
        re.sub(r"[^\w -]", "", line).strip().lower().replace(" ", "-") for line in re.findall(r"^## (.*)$", page, re.M)
    }
    links = re.findall(r"\[([^]]*)\]\(\.\./docs/report\.md#?([^)]*)\)", text)
    assert {anchor for _, anchor in links} <= headings
    assert links or not re.search(r"\breport('s)?\b (?!sum)", text.replace("is not reported", "")), (
        "the report is not linked"
    )
    named = re.findall(r"[Ss]ections? \d\.\d", text)
    assert len(named) == len([words for words, _ in links if re.search(r"[Ss]ections? \d\.\d", words)])
