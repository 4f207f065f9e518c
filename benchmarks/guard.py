"""Has a headline figure become worse? One row of each kind, measured again and compared with evidence.json.

The runs have the first seeds of the recorded row, so code that has not changed gives the recorded values. A figure is
worse when its mean over the runs is farther from the best value than both the recorded mean of the same seeds and that
of all seeds, by more than 3 standard errors of a difference of such means, from the recorded spread between runs. A row
of one run has no spread: there the tolerance is 10 %. An outcome that no recorded run had is worse, too. Times are not
compared, only ratios of times that were taken in the same run.

Exit code 0: nothing is worse; 1: a figure is; 2: there is no evidence to compare with.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from evidence_rows import FIGURES, KINDS, ROWS, Figure, Row
from harness import EVIDENCE, Figures, arguments, check_at_least, pooled, print_table

from sixthsense.running.warmup import warm_up

RUNS = {"victoria": 1, "relations.intel": 1, "tour.office.isam2": 4, "explore.apartment": 3, "kernels": 1}
"""how many runs of which rows"""

SIGMAS = 3.0
TOLERANCE = 0.1  # of the value of a row that has one run
ROUNDING = 1e-4  # the JSON has six digits


class Comparison(NamedTuple):
    """A figure as recorded and as it is now."""

    row: str
    title: str
    recorded: str
    now: str
    is_worse: bool


def loss(figure: Figure, value: float) -> float:
    """How bad a value is; differences are in the unit of the figure."""
    if figure.best == "high":
        return -value
    return value if figure.best == "low" else abs(value - float(figure.best))


def tolerance(recorded: Sequence[float], runs: int) -> float:
    """By how much the mean of `runs` may be worse than that of the recorded runs."""
    slack = ROUNDING * abs(float(np.mean(recorded)))
    if len(recorded) == 1:
        return TOLERANCE * abs(recorded[0]) + slack
    return SIGMAS * float(np.std(recorded, ddof=1)) * math.sqrt(1.0 / runs + 1.0 / len(recorded)) + slack


def compared(key: str, figure: Figure, recorded: Sequence[float], now: Sequence[float]) -> Comparison:
    """A figure of a row: all recorded values, of which the first have the seeds of those `now`."""
    value = float(np.mean(now))
    allowed = tolerance(recorded, len(now))
    befores = (float(np.mean(recorded)), float(np.mean(recorded[: len(now)])))
    is_worse = all(loss(figure, value) > loss(figure, before) + allowed for before in befores)
    shown = [f"{figure.scale * number:.4g}" for number in (befores[0], allowed, value)]
    return Comparison(key, figure.title, f"{shown[0]} ({shown[1]})", shown[2], is_worse)


def comparisons(row: Row, recorded: Mapping[str, Any], runs: Sequence[Figures]) -> list[Comparison]:
    """All judged figures of a row, and its outcomes."""
    found = []
    for figure in FIGURES[row.kind]:
        before = [value for value in recorded["values"].get(figure.name, ()) if value is not None]
        now = [run[figure.name] for run in runs if run.get(figure.name) is not None]
        if figure.best != "" and before and now:
            found.append(compared(row.key, figure, before, now))
    known = set(recorded["outcomes"])
    now_outcomes = {run["outcome"] for run in runs if "outcome" in run}
    if known:
        worse = not now_outcomes <= known
        shown = ", ".join(sorted(known)), ", ".join(sorted(now_outcomes))
        found.append(Comparison(row.key, "outcome", *shown, worse))
    return found


def _figures(item: tuple[Row, int]) -> Figures:
    row, seed = item
    return KINDS[row.kind](row.setting, seed)


def chosen_rows(recorded: Mapping[str, Any], runs: Mapping[str, int]) -> list[Row]:
    """The rows to repeat, as many seeds of each as wanted and recorded; without those whose data is missing."""
    found = []
    for row in ROWS:
        if row.key in runs:
            if row.key not in recorded or not row.is_possible():
                print(f"{row.key}: skipped, {'not recorded' if row.is_possible() else f'needs {row.needs}'}")
                continue
            found.append(replace(row, seeds=min(runs[row.key], len(recorded[row.key]["seeds"]))))
    return found


def main(runs: Mapping[str, int] = RUNS) -> int:
    parser = arguments(__doc__, may_keep=False)
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1)
    if not EVIDENCE.exists():
        print(f"guard.py: found no {EVIDENCE.name}, allowed: after `make evidence`", file=sys.stderr)
        return 2
    recorded = json.loads(EVIDENCE.read_text())["rows"]
    rows = chosen_rows(recorded, runs)
    items = [(row, seed) for row in rows for seed in recorded[row.key]["seeds"][: row.seeds]]
    made = list(zip(items, pooled(_figures, items, options.jobs, warm_up), strict=True))
    lines = [["row", "figure", "recorded (tolerance)", "now", ""]]
    is_worse = False
    for row in rows:
        for found in comparisons(row, recorded[row.key], [figures for (of, _), figures in made if of == row]):
            lines.append([*found[:4], "WORSE" if found.is_worse else ""])
            is_worse |= found.is_worse
    print_table(lines)
    return int(is_worse)


if __name__ == "__main__":
    sys.exit(main())
