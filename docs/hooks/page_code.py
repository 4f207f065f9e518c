"""The code of a page of docs/ as one program."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

DOCS = Path(__file__).parents[1]
BLOCK = re.compile(r'^```(python|console|toml)(?: title="(.*?)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)


def script(page: str, folder: Path) -> str:
    """The Python blocks and the commands of a page, in their order; its titled files are written into the folder."""
    lines = ["from sixthsense.cli import main"]
    for language, title, text in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        if language == "toml" and title:
            (folder / title).write_text(text, encoding="utf-8")
        elif language == "python":
            lines.append(text)
        elif language == "console":
            for line in text.splitlines():
                command, *words = shlex.split(line.removeprefix("$ "))
                assert command == "sixthsense"
                lines.append(f"assert main({words}) == 0")
    return "\n".join(lines)
