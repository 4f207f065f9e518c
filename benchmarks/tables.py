"""Tables of the pages, written from the files of results: `evidence.json`, `evidence_logs.json` and `results/*.json`.

    python benchmarks/tables.py    # write them again

A table stands between two HTML comments with its name, `<!-- evidence: NAME -->` and `<!-- evidence: end of NAME -->`.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from evidence_logs import Line, lines, seeds_of
from evidence_rows import FIGURES, Figure, Kind
from harness import EVIDENCE, HERE, LOGS, RESULTS, mean_and_error

PAGES = (HERE.parent / "README.md", *sorted((HERE.parent / "docs" / "results").glob("*.md")))
MARKER = re.compile(r"<!-- evidence: (?!end of )(.+?) -->")

Measured = Mapping[str, Any]
"""a row of the JSON: kind, setting, commit, seeds, outcomes, and per figure a value for each seed"""
Rows = Mapping[str, Measured]
Lines = list[list[str]]

HEADS: dict[Kind, tuple[str, ...]] = {
    "tour": ("tour of 200 s", "estimator"),
    "explore": ("exploration",),
    "relations": ("log",),
    "mrclam": ("MRCLAM set 6, robot 3",),
    "victoria": ("Victoria Park",),
    "circle": ("landmark circle",),
    "kernels": ("kernels",),
}
"""column names of the setting"""

ORDER = ("rectangle", "block", "apartment", "office", "loop", "ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2")


def cell(figure: Figure, row: Measured) -> str:
    """Mean ± standard error; a count in full; empty where no run measured the figure."""
    values = [figure.scale * value for value in row["values"].get(figure.name, ()) if value is not None]
    if not values:
        return ""
    return f"{sum(values):.0f}" if figure.name == "collisions" else with_error(values, figure.form)


def with_error(values: list[float], form: str) -> str:
    """Mean ± standard error; of one value the value."""
    mean, error = mean_and_error(values)
    return f"{mean:{form}}" if error is None else f"{mean:{form}} ± {error:{form}}"


def outcomes(row: Measured) -> str:
    """The outcomes of the runs with their numbers."""
    return ", ".join(f"{count} {outcome}" for outcome, count in Counter(row["outcomes"]).most_common())


def markdown(lines: Sequence[Sequence[str]], text: int = 1) -> str:
    """A table whose first line holds the column names; the first `text` columns are words, the others numbers."""
    rule = ["---"] * text + ["---:"] * (len(lines[0]) - text)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (lines[0], rule, *lines[1:]))


def table(rows: Rows, kind: Kind) -> str:
    """The table of a kind of row, with the code and the machine that measured it; empty without a row."""
    own = [row for row in rows.values() if row["kind"] == kind]
    if not own:
        return ""
    own.sort(key=lambda row: [ORDER.index(name) if name in ORDER else len(ORDER) for name in row["setting"]])
    heads = [*HEADS[kind], "n", *(["outcome"] if any(row["outcomes"] for row in own) else [])]
    lines = [[*heads, *(figure.title for figure in FIGURES[kind])]]
    for row in own:
        setting = [f"`{name}`" if name in ORDER[5:] else name for name in row["setting"]] or ["isam2 and the filters"]
        if kind == "kernels":
            setting = ["compiled"]
        cells = [*setting, str(len(row["seeds"])), *([outcomes(row)] if "outcome" in heads else [])]
        lines.append([*cells, *(cell(figure, row) for figure in FIGURES[kind])])
    origins = sorted({(row["commit"], row["machine"]) for row in own})
    of = f"Code: {'; '.join(f'`{commit}` on {machine}' for commit, machine in origins)}."
    return f"{markdown(lines, len(HEADS[kind]))}\n\n{of}"


def crossed(lines: Sequence[tuple[str, ...]], head: str, row: int, column: int) -> str:
    """Lines of one kind as a table of the numbers measured, by two parts of what they are of; bold is not as asked."""
    cells: dict[str, dict[str, str]] = {}
    for what, _, measured, met in lines:
        parts, shown = what.split(", "), ", ".join(re.findall(r"[\d.]+", measured))
        cells.setdefault(parts[row], {})[parts[column]] = shown if met == "yes" else f"**{shown}**"
    columns = list(dict.fromkeys(name for own in cells.values() for name in own))
    return markdown([[head, *columns], *([name, *(own.get(c, "") for c in columns)] for name, own in cells.items())])


def logs_text(rows: Mapping[str, Any]) -> str:
    """What is asked of scan matching on logs, and what was measured."""
    shown = [line for line in lines(rows, seeds_of(rows)[:1]) if line.measured]
    damages, drives = ([line for line in shown if line.what.startswith(kind)] for kind in ("damages", "repetition"))
    others = [line for line in shown if line not in damages and line not in drives]
    commits = Counter(row["commit"] for row in rows.values())
    return "\n\n".join([
        crossed(damages, "damaged log: mean m, largest m, time over the log's own", 2, 1),
        crossed(drives, "drive: false loop closures, closed %, ATE m", 1, 2),
        markdown([Line._fields, *others], 3),
        f"Code: {', '.join(f'`{commit}` ({count} runs)' for commit, count in commits.most_common())}.",
    ])  # fmt: skip


def result_text(found: Mapping[str, Any]) -> str:
    """The tables that a command has kept, the command, and where it ran."""
    kept = [_with_limits(lines) for lines in found["tables"]]
    parts = [f"    {found['command']}", *(markdown(lines, found["text"]) for lines in kept)]
    return "\n\n".join([*parts, f"Code: `{found['commit']}` on {found['machine']}."])


def _with_limits(lines: Sequence[Sequence[str]]) -> Sequence[Sequence[str]]:
    """Of a table of what is asked, the rows of which something is; the command prints the others, too."""
    asked = [lines[0].index(name) for name in ("asked", "limit") if name in lines[0]]
    return [row for row in lines if not asked or row[asked[0]]]


class Log(NamedTuple):
    """A log with what others published of it: translation and rotation against the hand-checked relations."""

    title: str
    cartographer: str
    """Hess et al. 2016"""
    graph_mapping: str
    """Kümmerle et al. 2009"""
    odometry: str


PUBLISHED = {
    "intel": Log(
        "Intel Research Lab", "0.023 ± 0.024 m, 0.45°", "0.031 ± 0.026 m, 1.3°", "7.37 ± 14.3 m, 39°"
    ),
    "fr079": Log("Freiburg 079", "0.045 ± 0.035 m, 0.54°", "0.056 ± 0.042 m", "6.50 ± 13.7 m, 30°"),
    "aces": Log("ACES, Austin", "0.038 ± 0.043 m, 0.37°", "0.044 ± 0.044 m", ""),
    "clinic": Log("Freiburg clinic, 1.4 km", "0.108 ± 0.196 m", "0.143 ± 0.180 m", ""),
}  # fmt: skip
DEVELOPED_ON = ("intel", "fr079")
"""the logs that scan matching was developed on; the others are an independent test of it"""
CIRCLE_PUBLISHED = "`ekf` 2.88 (200 runs)"
"""UKF-M's package (Brossard, Barrau and Bonnabel 2020)"""
SCENES = ("apartment", "office")


def values(rows: Rows, key: str, figure: str) -> list[float]:
    """The values of a figure over the seeds of a row."""
    return [value for value in rows[key]["values"][figure] if value is not None]


def mean(rows: Rows, key: str, figure: str) -> str:
    """Mean ± standard error over the seeds."""
    return with_error(values(rows, key, figure), ".2f")


def relations(rows: Rows, log: str) -> str:
    """Translation with its spread over the relations, and rotation."""
    (m,), (spread,), (deg,) = (
        values(rows, f"relations.{log}", name) for name in ("trans_m_mean", "trans_m_std", "rot_deg_mean")
    )
    return f"{m:.3f} ± {spread:.3f} m, {deg:.2f}°"


def beside_others(rows: Rows) -> Lines:
    """Each log here and as others published it."""
    heads = ["log", "here, defaults", "Cartographer", "graph mapping", "raw odometry"]
    return [heads, *([log.title, relations(rows, key), *log[1:]] for key, log in PUBLISHED.items())]


def headline(rows: Rows) -> Lines:
    """What the package reaches, in a line each."""
    explored = [key for key in rows if key.startswith("explore.")]
    outcomes = [outcome for key in explored for outcome in rows[key]["outcomes"]]
    touched = sum(sum(values(rows, key, "collisions")) for key in explored)
    least = min(min(values(rows, key, "coverage")) for key in explored)
    done = f"{outcomes.count('explored')} of {len(outcomes)}, {touched:.0f} collisions, coverage at least {least:.3f}"
    tours = [f"tour.{scene}.ekf-invariant" for scene in SCENES]
    position = [f"{1e3 * np.mean(values(rows, tour, 'ate_m')):.1f} mm" for tour in tours]
    circle = [f"`{name}` {mean(rows, f'circle.{name}', 'nees_heading')}" for name in ("ekf", "ekf-invariant")]
    speed = [f"{values(rows, f'relations.{log}', 'times_real_time')[0]:.0f}" for log in DEVELOPED_ON]
    gtsam = values(rows, "victoria", "graph_error_ratio")[0]
    return [
        ["what", "here", "published"],
        *(
            [f"{log.title}, error of relations", relations(rows, key), f"Cartographer {log.cartographer}"]
            for key, log in PUBLISHED.items()
            if key in DEVELOPED_ON
        ),
        [f"explorations of {len(explored)} scenes", done, ""],
        ["tours of apartment and office: position error", ", ".join(position), ""],
        ["the same: pose NEES (3 is consistent)", ", ".join(mean(rows, tour, "nees") for tour in tours), ""],
        ["landmark circle: heading NEES (1 is consistent)", ", ".join(circle), CIRCLE_PUBLISHED],
        ["Victoria Park: graph error of `isam2` over GTSAM's", f"{gtsam:.4f}", ""],
        ["replay of the two logs, times real time", " and ".join(speed), ""],
    ]


def texts() -> dict[str, str]:
    """The text of each name, from the files."""
    rows = json.loads(EVIDENCE.read_text())["rows"]
    found: dict[str, str] = {kind: table(rows, kind) for kind in FIGURES}
    found["headline"] = markdown(headline(rows), 3)
    found["beside others"] = markdown(beside_others(rows))
    found["logs"] = logs_text(json.loads(LOGS.read_text())["rows"])
    return found | {file.stem: result_text(json.loads(file.read_text())) for file in sorted(RESULTS.glob("*.json"))}


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


def written(page: str, known: Mapping[str, str]) -> str:
    """A page with the text of each name that it has markers of; ValueError for a name without a file."""
    for name in MARKER.findall(page):
        if name not in known:
            raise ValueError(f"markers: found {name!r}, allowed: {', '.join(known)}")
        page = placed(page, name, known[name])
    return page


def write_pages() -> None:
    """Put the tables into the pages."""
    known = texts()
    for page in PAGES:
        page.write_text(written(page.read_text(encoding="utf-8"), known), encoding="utf-8")


if __name__ == "__main__":
    write_pages()
