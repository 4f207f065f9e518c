"""The pictures of the repository and their registry agree; `make pictures-check` compares what they show."""

import io
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

sys.path.insert(0, str(DOCS))
import pictures  # noqa: E402

KEPT = sorted(str(file.relative_to(ROOT)) for kind in ("png", "gif", "webp") for file in DOCS.rglob(f"*.{kind}"))


def test_every_picture_is_in_the_registry() -> None:
    assert sorted(picture.file for picture in pictures.pictures() if not picture.is_notebook) == KEPT


@pytest.mark.parametrize("picture", [one for one in pictures.pictures() if one.file.endswith(".png")], ids=str)
def test_a_picture_carries_its_command_and_the_commit(picture: pictures.Picture) -> None:
    with Image.open(ROOT / picture.file) as image:
        assert image.info["Command"] == picture.command
        assert re.fullmatch(r"[0-9a-f]{10}", image.info["Commit"])


def test_a_page_quotes_what_the_command_of_its_picture_printed() -> None:
    quoting = [picture for picture in pictures.pictures() if picture.quoted]
    for picture in quoting:
        with Image.open(ROOT / picture.file) as image:
            page = (DOCS / picture.quoted).read_text(encoding="utf-8")
            assert pictures.quoted(page, picture.file)[0] == image.info["Output"]
    assert quoting


def test_the_film_of_the_first_page_is_of_the_run_that_make_run_makes() -> None:
    (film,) = (picture for picture in pictures.pictures() if picture.file == "docs/exploration.webp")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (made,) = re.findall(r"^\t@\$\(BIN\)/(sixthsense run .*) --out runs/first", makefile, re.MULTILINE)
    assert film.commands[0].removesuffix(" --out first") == made


def test_a_picture_is_compared_by_what_it_shows() -> None:
    shown = np.full((600, 800, 3), 255, dtype=np.uint8)
    shown[100:300, 200:500] = 0
    near, other = shown.copy(), shown.copy()
    near[100, 200:500] = 255  # a line of pixels
    other[100:300, 200:500] = 255
    first, second, third = (png(pixels) for pixels in (shown, near, other))
    assert pictures.difference(first, second) <= pictures.MOST_DIFFERENT < pictures.difference(first, third)
    assert pictures.difference(first, png(shown[:300])) == 1.0


def png(pixels: np.ndarray) -> bytes:
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG")
    return content.getvalue()
