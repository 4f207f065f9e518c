"""Tables of text cells: aligned for a terminal, or as HTML for a notebook or a page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class TableStyle:
    """HTML attributes of a table's cells, each with a space before it."""

    cell: str = ""
    """of a cell with words"""
    number: str = ""
    """of a cell with a number"""
    heading: str = ""
    """of a heading over all columns"""


_INLINE = ' style="text-align:left;padding:0 1em 0 0"'
NOTEBOOK = TableStyle(_INLINE, _INLINE, _INLINE)
"""with its own CSS, since a notebook has none"""
PAGE = TableStyle("", ' class="value"', ' class="group"')
"""with the classes of a page that brings its CSS"""


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


def html_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], numbers: int = 0, style: TableStyle = NOTEBOOK
) -> str:
    """An HTML table with the column names `head`; every cell is escaped.

    The `numbers` columns after the first hold numbers. A row of one cell is a heading over all columns.
    """
    attributes = [style.cell, *[style.number] * numbers, *[style.cell] * (len(head) - 1 - numbers)]

    def line(tag: str, cells: Sequence[str]) -> str:
        parts = (
            f"<{tag}{attribute}>{html.escape(cell)}</{tag}>" for attribute, cell in zip(attributes, cells, strict=True)
        )
        return f"<tr>{''.join(parts)}</tr>"

    lines = [line("th", head)]
    for row in rows:
        if len(row) == 1:
            lines.append(f'<tr><th{style.heading} colspan="{len(head)}">{html.escape(row[0])}</th></tr>')
        else:
            lines.append(line("td", row))
    return "<table>\n" + "\n".join(lines) + "\n</table>"
