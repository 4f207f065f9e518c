"""The notebooks as they are committed; `make notebooks` runs them."""

import importlib
import json
import re
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


def test_what_a_student_has_written_is_used_in_the_cells_after_it(notebook: Path) -> None:
    """Or in earlier ones that they call, if it is kept in a table of answers, `OWN`."""
    sources = ["".join(cell["source"]) for cell in code_cells(notebook)]
    checks = [k for k, source in enumerate(sources) if 'check("' in source]
    for k in checks:
        name, is_kept, _ = sources[k].partition(" = check(")
        assert is_kept and any(name in other for n, other in enumerate(sources) if n > k or (n < k and "[" in name))


def package_names(notebook: Path) -> set[str]:
    """Full names of what a notebook imports from the package or takes as an attribute of `ss`."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    source = "\n".join("".join(cell["source"]) for cell in cells)
    found = {f"sixthsense.{name}" for name in re.findall(r"\bss\.(\w+)", source)}
    for module, names in re.findall(r"^ *from (sixthsense[\w.]*) import \(?([\w, ]+)", source, re.MULTILINE):
        found |= {f"{module}.{name}" for name in re.findall(r"(\w+)(?: as \w+)?", names)}
    return found


def is_public(name: str) -> bool:
    """Whether a name stands on the page of the interface, alone or with its module, or in a public room's `__all__`."""
    module, _, last = name.rpartition(".")
    return (
        name in LISTED
        or module in LISTED
        or name in PUBLIC_ROOMS
        or (module in PUBLIC_ROOMS and last in importlib.import_module(module).__all__)
    )


def test_a_notebook_uses_public_names_alone(notebook: Path) -> None:
    names = package_names(notebook)
    assert names and [name for name in sorted(names) if not is_public(name)] == []
    assert not is_public("sixthsense.core.se2.whitening") and not is_public("sixthsense.figures._axes")
