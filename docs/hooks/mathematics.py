r"""Convert formulae to MathML when the site is built, so that browsers draw them without a script.

Arithmatex marks the text between `$` or `$$`; this hook converts its LaTeX to MathML. Stretched brackets need a
mathematical font, which not every system has. The site includes STIX Two Math from the package ziamath.
"""

from __future__ import annotations

import html
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
_FONT = "STIXTwoMath-Regular.ttf"


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add the font to the folder of the style sheet that uses it."""
    from mkdocs.exceptions import PluginError
    from mkdocs.structure.files import File

    package = find_spec("ziamath")
    if package is None or package.origin is None:
        raise PluginError("mathematics: ziamath is missing, allowed: pip install -e '.[docs]'")
    font = Path(package.origin).parent / "fonts" / _FONT
    files.append(File.generated(config, f"styles/{_FONT}", abs_src_path=str(font)))
    return files


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Replace the formulae of a page; an unknown LaTeX command stops the build."""
    from latex2mathml.converter import convert
    from mkdocs.exceptions import PluginError

    def replaced(match: re.Match[str]) -> str:
        tag, bracket, formula = match.groups()
        formula = html.unescape(formula).strip()
        mathml = convert(formula, display="inline" if bracket == "(" else "block")
        if "\\" in re.sub(r"&#x0005C;", "", mathml):
            raise PluginError(f"{page.file.src_uri}: found {formula!r}, allowed: LaTeX that latex2mathml knows")
        return f'<{tag} class="formula">{mathml}</{tag}>'

    return _FORMULA.sub(replaced, content)
