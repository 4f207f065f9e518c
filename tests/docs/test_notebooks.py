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


def test_the_first_cell_installs_in_colab_alone(notebook: Path) -> None:
    first = json.loads(notebook.read_text(encoding="utf-8"))["cells"][0]
    assert first["cell_type"] == "code" and "setup" in first["metadata"]["tags"] and not first["outputs"]
    assert '"google.colab" in sys.modules' in "".join(first["source"])


def test_a_notebook_begins_with_its_title_its_badges_and_its_picture(notebook: Path) -> None:
    title, picture = json.loads(notebook.read_text(encoding="utf-8"))["cells"][1:3]
    text = "".join(title["source"])
    assert text.startswith("# ") and text.count(f"notebooks/{notebook.name})") == 2
    assert any("image/png" in output.get("data", {}) for output in picture["outputs"])


def test_a_notebook_has_a_slider_and_an_exercise_with_its_answer_folded(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = "".join("".join(cell["source"]) for cell in code_cells(notebook))
    text = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    assert len(re.findall(r"(?<!import )slider\(", code)) == 1
    assert text.count("## Exercise") == text.count("<summary>Answer</summary>") == 1


def test_a_notebook_is_small_enough_to_be_kept_in_every_version(notebook: Path) -> None:
    assert notebook.stat().st_size < MOST_BYTES
