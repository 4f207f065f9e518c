"""Tables of the evidence, rendered from its JSON, and their places in README.md and RESULTS.md."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from evidence_rows import FIGURES, Figure, Kind

Measured = Mapping[str, Any]
"""a row of the JSON: kind, setting, commit, seeds, outcomes, and per figure a value for each seed"""

HEADS: dict[Kind, tuple[str, ...]] = {
    "tour": ("tour of 200 s", "estimator"),
    "explore": ("exploration",),
    "relations": ("log",),
    "mrclam": ("MRCLAM set 6, robot 3",),
    "victoria": ("Victoria Park",),
    "kernels": ("kernels",),
}
"""column names of the setting"""

README_KINDS: tuple[Kind, ...] = ("tour", "explore", "relations", "victoria", "mrclam")

ORDER = ("rectangle", "block", "apartment", "office", "loop", "ekf", "ekf-invariant", "isam2")


def mean_and_error(values: list[float]) -> tuple[float, float | None]:
    """Mean over runs and its standard error; None for one run."""
    given = np.array(values, dtype=np.float64)
    error = float(given.std(ddof=1) / np.sqrt(len(given))) if len(given) > 1 else None
    return float(given.mean()), error


def cell(figure: Figure, row: Measured) -> str:
    """Mean ± standard error; a count in full; empty where no run measured the figure."""
    values = [figure.scale * value for value in row["values"].get(figure.name, ()) if value is not None]
    if not values:
        return ""
    mean, error = mean_and_error(values)
    if figure.name == "collisions":
        return f"{sum(values):.0f}"
    return f"{mean:{figure.form}}" if error is None else f"{mean:{figure.form}} ± {error:{figure.form}}"


def outcomes(row: Measured) -> str:
    """The outcomes of the runs with their numbers."""
    return ", ".join(f"{count} {outcome}" for outcome, count in Counter(row["outcomes"]).most_common())


def table(rows: Mapping[str, Measured], kind: Kind, with_origin: bool) -> list[str]:
    """The lines of the table of a kind of row, none if no such row was measured; with seeds and commit if wanted."""
    own = [row for row in rows.values() if row["kind"] == kind]
    if not own:
        return []
    own.sort(key=lambda row: [ORDER.index(name) if name in ORDER else len(ORDER) for name in row["setting"]])
    figures = FIGURES[kind]
    heads = [*HEADS[kind], "n", *(["outcome"] if any(row["outcomes"] for row in own) else [])]
    lines = [[*heads, *(figure.title for figure in figures), *(["seeds", "commit"] if with_origin else [])]]
    for row in own:
        setting = [f"`{name}`" if name in ORDER[5:] else name for name in row["setting"]] or ["isam2 and the filters"]
        if kind == "kernels":
            setting = ["compiled"]
        cells = [*setting, str(len(row["seeds"])), *([outcomes(row)] if "outcome" in heads else [])]
        cells += [cell(figure, row) for figure in figures]
        seeds = f"{row['seeds'][0]}-{row['seeds'][-1]}" if len(row["seeds"]) > 1 else f"{row['seeds'][0]}"
        lines.append([*cells, *([seeds, f"`{row['commit']}`"] if with_origin else [])])
    text = len(HEADS[kind])
    rule = ["---"] * text + ["---:"] * (len(lines[0]) - text)
    return ["| " + " | ".join(cells) + " |" for cells in (lines[0], rule, *lines[1:])]


def rendered(evidence: Mapping[str, Any]) -> dict[str, str]:
    """The text between the markers of each name: `readme`, and `results` with seeds and commit of every row."""
    rows = evidence["rows"]
    origins = sorted({(row["commit"], row["machine"]) for row in rows.values()})
    of = f"Code: {'; '.join(f'`{commit}` on {machine}' for commit, machine in origins)}."
    found = {}
    for name, kinds, with_origin in (("readme", README_KINDS, False), ("results", tuple(FIGURES), True)):
        parts = [part for kind in kinds if (part := table(rows, kind, with_origin))]
        found[name] = "\n\n".join(["\n".join(part) for part in parts] + [of])
    return found


def markers(name: str) -> tuple[str, str]:
    """The comments before and after the text of a name."""
    return f"<!-- evidence: {name} -->", f"<!-- evidence: end of {name} -->"


def placed(page: str, name: str, text: str) -> str:
    """The page with `text` between the markers of `name`; ValueError if it has no such markers."""
    begin, end = markers(name)
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"markers: found none of {name!r}, allowed: {begin} and {end}")
    return pattern.sub(lambda _: f"{begin}\n\n{text}\n\n{end}", page, count=1)
