"""A link to the glossary at the end of every page of the site."""

from __future__ import annotations

from typing import Any

PAGE = "glossary.md"


def on_page_content(content: str, page: Any, files: Any, **_: Any) -> str:
    """Add the link, but not to the glossary itself; the search leaves it out."""
    if page.file.src_uri == PAGE:
        return content
    address = files.get_file_from_path(PAGE).url_relative_to(page.file)
    return f'{content}\n<p class="glossary" data-search-exclude>Words: <a href="{address}">Glossary</a></p>'
