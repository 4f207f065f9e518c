"""Tables of text cells: aligned for a terminal, or as HTML for a notebook or a page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any, Literal

_INLINE = ' style="text-align:left;padding:0 1em 0 0"'
"""of every cell in a notebook, which has no CSS"""


def digits(value: Any) -> str:
    """A value as text: a float with four significant digits, everything else as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def text_table(rows: Sequence[Sequence[str]], align: Literal["left", "right"] = "left") -> str:
    """Rows in columns of equal width, two spaces apart, without a line break at the end.

    `align` holds for the columns after the first, which is always flush left. A row of one cell is a heading: it does
    not widen the first column.
    """
    widths = [max(map(len, column)) for column in zip(*(row for row in rows if len(row) > 1), strict=True)]
    lines = []
    for row in rows:
        if len(row) == 1:
            lines.append(row[0])
            continue
        pad = str.ljust if align == "left" else str.rjust
        first, *rest = row
        cells = [first.ljust(widths[0]), *map(pad, rest, widths[1:])]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: int | None = None) -> str:
    """An HTML table with the column names `head`; every cell is escaped.

    A row of one cell is a heading over all columns. The table has its own CSS, for a notebook, or with `numbers`, how
    many columns after the first hold numbers, the classes "value" and "group" of a page that brings its CSS.
    """
    attributes = [_INLINE] * len(head)
    if numbers is not None:
        attributes = ["", *[' class="value"'] * numbers, *[""] * (len(head) - 1 - numbers)]
    heading = _INLINE if numbers is None else ' class="group"'

    def line(tag: str, cells: Sequence[str]) -> str:
        parts = (
            f"<{tag}{attribute}>{html.escape(cell)}</{tag}>" for attribute, cell in zip(attributes, cells, strict=True)
        )
        return f"<tr>{''.join(parts)}</tr>"

    lines = [line("th", head)]
    for row in rows:
        if len(row) == 1:
            lines.append(f'<tr><th{heading} colspan="{len(head)}">{html.escape(row[0])}</th></tr>')
        else:
            lines.append(line("td", row))
    return "<table>\n" + "\n".join(lines) + "\n</table>"
