"""Pages of the site that other files must agree with; `make docs` builds the site and checks its links."""

import re
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from sixthsense.config.version import __version__

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

sys.path.insert(0, str(DOCS / "hooks"))


def test_every_notebook_is_a_page_of_the_site_under_its_name() -> None:
    listed = re.findall(r"^ +- notebooks/(\w+)\.md$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == [notebook.stem for notebook in NOTEBOOKS]


def test_a_page_of_a_notebook_has_its_text_code_and_pictures_and_no_link_to_a_notebook() -> None:
    pytest.importorskip("nbconvert")
    import notebooks

    text, pictures = notebooks.page(ROOT / "notebooks" / "10_your_own.ipynb")
    assert text.lstrip().startswith("# An estimator of your own") and "```python" in text
    assert pictures and all(name in text for name in pictures)
    assert not re.search(r"\]\((?!https:)[^)]*\.ipynb\)", text)
    assert "[Open in Colab](https:" in text and "badge" not in text and "google.colab" not in text
    assert text.count('<details markdown="1">') == 2  # the code of the first picture, and the answer of the exercise


@pytest.mark.parametrize("page", ["gallery.md", "report_figures.md", "index.md"])
def test_every_picture_of_a_page_is_there_and_has_a_text_for_who_cannot_see_it(page: str) -> None:
    found = re.findall(r"!\[(.*?)\]\((.*?)\)", (DOCS / page).read_text(encoding="utf-8"))
    assert found
    assert all((DOCS / file).is_file() and len(text) > 20 for text, file in found)


WORDS = (
    "keyframe", "observation", "loop closure", "scan matching", "odometry", "innovation", "gate", "NIS", "NEES",
    "frontier", "viewpoint", "inflation", "clearance", "submap", "link", "landmark", "pose graph",
)  # fmt: skip


def test_the_glossary_explains_the_words_of_the_field_and_names_the_older_ones() -> None:
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    explained = re.findall(r"^- \*\*(.+?)\*\*( \(.+?\))?: ", text, re.MULTILINE | re.DOTALL)
    words = [word for word, _ in explained]
    assert set(WORDS) <= set(words) and len(words) == len(set(words)) == text.count("\n- ")
    older = " ".join(note for _, note in explained)
    assert all(f"*{word}*" in older for word in ("key scan", "sighting", "revisit", "aligned scans"))


def test_every_page_but_the_glossary_ends_with_a_link_to_it() -> None:
    pytest.importorskip("mkdocs")
    import glossary
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import File, Files

    names = ("glossary.md", "index.md", "howto/live.md")
    files = Files([File(name, "docs", "site", use_directory_urls=False) for name in names])

    def made(name: str) -> str:
        page = SimpleNamespace(file=files.get_file_from_path(name))
        return glossary.on_page_content("<p>text</p>", page, files=files, config=MkDocsConfig())

    assert [re.findall('href="(.*?)"', made(name)) for name in names] == [[], ["glossary.html"], ["../glossary.html"]]
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "\n  - docs/hooks/glossary.py\n" in settings and "\n  - Glossary: glossary.md\n" in settings


def test_search_needs_no_other_server() -> None:
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    (script,) = re.findall(r"polyfills: \[(.*?)\]", settings)
    assert "iframe-worker" in script and (DOCS / script).is_file()
    assert "  - offline\n" in settings and not re.findall(r"https?://(?!\S*github)", settings)


def test_version_and_addresses_are_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    repository = project["urls"]["Homepage"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in citation and f"repository-code: {repository}\n" in citation
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "## [Unreleased]" in changes and repository in changes
    assert all(
        address.startswith((repository, "https://sixth-sense-slam.github.io")) for address in project["urls"].values()
    )
