"""The notebooks as they are committed; `make notebooks` runs them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
MOST_BYTES = 400_000
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
