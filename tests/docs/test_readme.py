"""README.md is a page that a newcomer reads in a minute, and what it says runs."""

import re
from pathlib import Path

import pytest

from sixthsense.cli import COMMANDS, main

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
GENERAL = ("", "--help", "--version")


def test_the_lines_of_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    exec(compile(code.replace("seed=3", "seed=3, max_time=8.0"), "README.md", "exec"), {"__name__": "README"})


@pytest.mark.parametrize("page", ["README.md", "docs/start.md", "docs/howto/view.md", "docs/gallery.md"])
def test_the_commands_of_a_page_are_there_with_their_options(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Those that need no robot and no log are run by hand before a release; this finds the misspelt ones."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.findall(r"(?<![\w./-])(?<!import )sixthsense ((?:--)?\w+)?([^\n`#)]*)", text)
    assert found
    for name, rest in found:
        assert name in GENERAL or name in COMMANDS, name
        flags = re.findall(r"--([a-z][\w.-]*)", rest)
        if name not in COMMANDS or not flags:
            continue
        if main([name, "--help", "all"]) != 0:
            assert main([name, "--help"]) == 0
        known = capsys.readouterr().out
        assert [flag for flag in flags if f"--{flag.rpartition('.')[0] or flag}" not in known + "--help"] == []


def test_the_targets_of_make_are_there() -> None:
    targets = re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(re.findall(r"(?:`|^ {4})make ([\w-]+)", TEXT, re.MULTILINE)) <= set(targets)


def test_links_of_readme_and_pages_lead_to_files_of_the_checkout() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([\w./-]+\.\w+)[#)]", page.read_text("utf-8"))]
    assert len(links) > 200 and [link for link in links if not (link[0].parent / link[1]).exists()] == []
