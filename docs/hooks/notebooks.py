"""The notebooks as pages of the site, as they are committed: nothing is run when the site is built."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "notebooks"
BADGE = re.compile(r"\[!\[Open in (\w+)\]\([^)]*\)\]\(([^)]*)\)")
"""a link with a picture of another server, of which the site loads none"""
CODE = re.compile(r"^```python\n.*?^```$", re.DOTALL | re.MULTILINE)


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add a page for each notebook, and its pictures beside it."""
    from mkdocs.structure.files import File

    for notebook in sorted(FOLDER.glob("*.ipynb")):
        text, pictures = page(notebook)
        files.append(File.generated(config, f"notebooks/{notebook.stem}.md", content=text))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Lead links to notebooks of the repository to their pages."""
    return re.sub(r"\]\(\.\./((?:\.\./)*notebooks/\w+)\.ipynb\)", r"](\1.md)", markdown)


def page(notebook: Path) -> tuple[str, dict[str, bytes]]:
    """Return the Markdown of a notebook, and its pictures by file name."""
    import nbformat
    from nbconvert import MarkdownExporter

    resources = {"unique_key": notebook.stem, "output_files_dir": f"{notebook.stem}_files"}
    content = nbformat.read(notebook, as_version=4)
    content.cells = [cell for cell in content.cells if "setup" not in cell.metadata.get("tags", [])]
    text, made = MarkdownExporter().from_notebook_node(content, resources=resources)
    text = BADGE.sub(r"[Open in \1](\2)", text).replace(")\n[Open in", ") · [Open in")
    # The picture comes first; the site renders what is folded only where it is told to.
    text = CODE.sub("<details>\n<summary>The code of this picture</summary>\n\n\\g<0>\n\n</details>", text, count=1)
    text = text.replace("<details>", '<details markdown="1">')
    # Links in the repository: to pages of docs/, and to other notebooks.
    text = re.sub(r"\]\(\.\./docs/", "](../", text)
    text = re.sub(r"\]\(([\w]+)\.ipynb\)", r"](\1.md)", text)
    return text, made["outputs"]
