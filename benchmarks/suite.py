"""Measure the cases of `cases.py`, keep a row of results for each, and write the tables of README.md and the pages.

    python benchmarks/suite.py relations tour.office     # the cases whose name begins so; interrupted, it resumes
    python benchmarks/suite.py --budget 60               # rows of another package, the oldest first, for an hour
    python benchmarks/suite.py --check tour.office       # measure again, and compare with the rows
    python benchmarks/suite.py --tables                  # write the tables alone

A row has the figures of each seed, the commit, the tree of the package, the machine and the time. `--check` repeats the
first seeds of rows, so code that has not changed gives the same values. A figure is worse when its mean is farther from
what is asked than both the recorded mean of the same seeds and that of all seeds, by more than 3 standard errors of a
difference of such means, from the recorded spread. A row of one run has no spread: there the tolerance is 10 %. An
outcome that no recorded run had is worse, too.

Exit code 0; 1: a run has failed, or a figure is worse; 2: bad input.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import platform
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from cases import KINDS, Column, Kind
from runs import Figures
from tqdm import tqdm

from sixthsense.campaigns.engine import Processes, Rows, carry_out

HERE = Path(__file__).resolve().parent
CACHE, RESULTS = HERE / ".evidence", HERE / "results.json"
SIGMAS, TOLERANCE, ROUNDING = 3.0, 0.1, 1e-4
"""of `--check`: standard errors, the share of a value that has no spread, and what the digits of a row leave open"""
Row = dict[str, Any]


class Case(NamedTuple):
    """A kind of measurement with its setting."""

    kind: str
    setting: tuple[str, ...]

    @property
    def name(self) -> str:
        """Its name in the results."""
        return ".".join((self.kind, *self.setting))

    @property
    def of(self) -> Kind:
        """How it is measured and judged."""
        return KINDS[self.kind]


CASES = [Case(name, setting) for name, kind in KINDS.items() for setting in kind.cases]


def main() -> int:
    """Measure, check, or write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("prefix", nargs="*", help="beginnings of the names of cases; with --budget or --check: all")
    parser.add_argument("--check", action="store_true", help="compare with the rows, and write none")
    parser.add_argument("--budget", type=float, metavar="MINUTES", help="rows of another package; begin no run after")
    parser.add_argument("--tables", action="store_true", help="write the tables alone")
    parser.add_argument("--list", action="store_true", help="the cases, with the commit and the age of their rows")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    options = parser.parse_args()
    rows = recorded()
    chosen = [case for case in CASES if not options.prefix or case.name.startswith(tuple(options.prefix))]
    if not chosen:
        parser.error(f"found no case {', '.join(options.prefix)}, allowed: beginnings of {', '.join(KINDS)}")
    if options.tables:
        write_pages(rows)
    elif options.list:
        print("\n".join(f"{case.name}: {rows.get(case.name, {}).get('commit', 'not measured')}" for case in chosen))
    elif options.check:
        return check(
            [case for case in chosen if case.of.checked and rows.get(case.name, {}).get("seeds")], rows, options.jobs
        )
    elif options.budget is not None or options.prefix:
        return record(chosen, rows, options)
    else:
        parser.error("found no prefix, allowed: one, or --budget, --check, --tables, --list")
    return 0


def record(chosen: Sequence[Case], rows: dict[str, Row], options: argparse.Namespace) -> int:
    """Measure cases, write the rows that are complete and the tables; 1 if a run has failed."""
    package, until = package_tree(), math.inf
    if options.budget is not None:
        until = time.time() + 60.0 * options.budget
        chosen = [case for case in chosen if rows.get(case.name, {}).get("package") != package]
        chosen = sorted(chosen, key=lambda case: rows.get(case.name, {}).get("time", 0.0))
    made, failed = measured({case: case.of.seeds for case in possible(chosen)}, until, options.jobs)
    for case, runs in made.items():
        rows[case.name] = collected(case, runs, package)
    RESULTS.write_text(as_json(rows))
    write_pages(rows)
    print("\n".join(table_of(kind, rows) for kind in dict.fromkeys(case.kind for case in made)))
    print(f"{len(made)} of {len(chosen)} rows; the same command goes on", *failed, sep="\n", file=sys.stderr)
    return int(bool(failed))


def possible(chosen: Iterable[Case]) -> list[Case]:
    """The cases whose data are there; what is left out is printed."""
    found = []
    for case in chosen:
        if missing := case.of.missing(case.setting):
            print(f"{case.name}: left out, needs {missing}", file=sys.stderr)
        else:
            found.append(case)
    return found


def measured(due: Mapping[Case, Sequence[int]], until: float, jobs: int) -> tuple[dict[Case, list[Figures]], list[str]]:
    """The figures of the seeds of each case all of whose runs are there, and what has failed.

    Runs are kept by the tree of the package. Those that are to run alone come first, one after the other.
    """
    kept = Rows(CACHE / f"{package_tree()}.jsonl")
    made, failed = kept.read(), list[str]()
    for alone in (True, False):
        items = {
            f"{case.name}#{seed}": (case.kind, case.setting, seed)
            for case, seeds in due.items()
            for seed in seeds
            if case.of.alone == alone and f"{case.name}#{seed}" not in made
        }
        if not items:
            continue
        with Processes(1 if alone else jobs, warm) as pool, tqdm(total=len(items), disable=None, leave=False) as bar:
            for key, future in carry_out(pool, figures_of, items, until):
                if (error := future.exception()) is not None:
                    failed.append(f"{key}: {type(error).__name__}: {error}".splitlines()[0])
                else:
                    made[key] = {"key": key, **future.result()}
                    kept.add(made[key])
                bar.update()
    keys = {case: [f"{case.name}#{seed}" for seed in seeds] for case, seeds in due.items()}
    return {case: [made[key] for key in own] for case, own in keys.items() if made.keys() >= {*own}}, failed


def figures_of(item: tuple[str, tuple[str, ...], int]) -> Figures:
    """The figures of one run."""
    kind, setting, seed = item
    found = KINDS[kind].run(setting, seed)
    return {name: value if value is None or isinstance(value, str) else float(value) for name, value in found.items()}


def warm() -> None:
    """Compile the hot loops, once in each process, and use one thread for BLAS."""
    from threadpoolctl import threadpool_limits

    from sixthsense.running.warmup import warm_up

    threadpool_limits(limits=1, user_api="blas")
    warm_up()
    warm_up("scan-matching")


def collected(case: Case, runs: Sequence[Figures], package: str) -> Row:
    """The row of a case; a figure that a run did not measure is None there."""
    names = dict.fromkeys(name for run in runs for name in run if name not in ("key", "outcome"))
    values = {name: [None if run.get(name) is None else float(f"{run[name]:.6g}") for run in runs] for name in names}
    outcomes = [run["outcome"] for run in runs if "outcome" in run]
    return {
        "commit": git("log", "-1", "--format=%h", "--abbrev=10", "--", "sixthsense"), "package": package,
        "machine": machine(), "time": round(time.time()), "seeds": list(case.of.seeds), "outcomes": outcomes,
        "values": values,
    }  # fmt: skip


def recorded() -> dict[str, Row]:
    """The rows by name."""
    return dict(json.loads(RESULTS.read_text())["rows"]) if RESULTS.exists() else {}


def as_json(rows: Mapping[str, Row]) -> str:
    """JSON with a row per line, in the order of the cases; rows of cases that are gone are left out."""
    lines = [f"  {json.dumps(case.name)}: {json.dumps(rows[case.name])}" for case in CASES if case.name in rows]
    return '{\n "rows": {\n' + ",\n".join(lines) + "\n }\n}\n"


def git(*words: str) -> str:
    """What git prints in this repository; RuntimeError where it fails."""
    done = subprocess.run(["git", *words], cwd=HERE.parent, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"git {words[0]}: {done.stderr.strip()}, allowed: a clone of the repository")
    return done.stdout.strip()


def package_tree() -> str:
    """The tree of the package, with a hash of what is not committed."""
    changed = git("diff", "HEAD", "--", "sixthsense", "scenes")
    tree = git("rev-parse", "HEAD:sixthsense")[:10]
    return f"{tree}+{hashlib.sha256(changed.encode()).hexdigest()[:6]}" if changed else tree


def machine() -> str:
    """Processor and versions, in one line."""
    info = Path("/proc/cpuinfo")
    rows = info.read_text().splitlines() if info.exists() else []
    models = [row.split(":")[1].strip() for row in rows if row.startswith("model name")]
    processor = f"{len(models)} x {models[0]}" if models else platform.processor() or platform.machine()
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
    return f"{processor}, {versions}, one BLAS thread"


# What a figure is over runs, and whether it is as asked


def over_runs(figure: str, values: Mapping[str, Sequence[float | None]]) -> tuple[float, float | None]:
    """A figure over the runs of a row, with its standard error if it is a mean: `name`, `name max`, `one / other`.

    NaN if no run measured it.
    """
    first, _, second = figure.partition(" / ")
    if second:
        total, of = (sum(value for value in values.get(name, ()) if value is not None) for name in (first, second))
        return (total / of if of else math.nan), None
    name, _, how = figure.partition(" ")
    known = np.array([value for value in values.get(name, ()) if value is not None], dtype=np.float64)
    if not len(known):
        return math.nan, None
    if how:
        return float(getattr(np, how)(known)), None
    return float(known.mean()), float(known.std(ddof=1) / math.sqrt(len(known))) if len(known) > 1 else None


def is_met(asked: str, value: float) -> bool:
    """Whether a value is as asked: `<= 0.5`, `>= 0.9` or `2.4 to 3.9`; true where there is no value or no limit."""
    return math.isnan(value) or loss(asked, value) <= 1e-9


def loss(asked: str, value: float) -> float:
    """How far a value is from what is asked; 0 or less if it is not farther."""
    if asked.startswith("<="):
        return value - float(asked[2:])
    if asked.startswith(">="):
        return float(asked[2:]) - value
    if " to " in asked:
        low, high = map(float, asked.split(" to "))
        return abs(value - 0.5 * (low + high)) - 0.5 * (high - low)
    return 0.0


def check(chosen: Sequence[Case], rows: Mapping[str, Row], jobs: int) -> int:
    """Measure the first seeds of cases again, and print what is worse; 1 if anything is, or has failed."""
    due = {case: rows[case.name]["seeds"][: case.of.checked] for case in possible(chosen)}
    made, failed = measured(due, math.inf, jobs)
    worse = list(failed)
    for case, runs in made.items():
        now = collected(case, runs, "")
        worse += [f"{case.name}: {text}" for text in worse_than(case.of.columns, rows[case.name], now)]
        print(f"{case.name}: compared {len(runs)} of {len(rows[case.name]['seeds'])} runs", file=sys.stderr)
    print("\n".join(worse) or "nothing is worse")
    return int(bool(worse))


def worse_than(columns: Sequence[Column], before: Row, now: Row) -> list[str]:
    """The figures of a row that are worse than their spread explains, and outcomes that it did not have."""
    found = [f"found outcome {outcome}" for outcome in {*now["outcomes"]} - {*before["outcomes"]}]
    for column in columns:
        name = column.figure.split()[0]
        known = [value for value in before["values"].get(name, ()) if value is not None]
        values = [value for value in now["values"].get(name, ()) if value is not None]
        if not (column.asked and known and values and " / " not in column.figure):
            continue
        allowed = ROUNDING * abs(float(np.mean(known))) + (
            SIGMAS * float(np.std(known, ddof=1)) * math.sqrt(1.0 / len(values) + 1.0 / len(known))
            if len(known) > 1
            else TOLERANCE * abs(known[0])
        )
        value, befores = float(np.mean(values)), [float(np.mean(known)), float(np.mean(known[: len(values)]))]
        if all(loss(column.asked, value) > loss(column.asked, mean) + allowed for mean in befores):
            found.append(
                f"{column.title}: found {value:.4g}, before {befores[0]:.4g}, allowed a change of {allowed:.2g}"
            )
    return found


# Tables

PAGES = (HERE.parent / "README.md", *sorted((HERE.parent / "docs" / "results").glob("*.md")))


def cell(column: Column, values: Mapping[str, Sequence[float | None]]) -> str:
    """A figure over runs with its standard error; bold if it is not as asked, empty if no run measured it."""
    value, error = over_runs(column.figure, values)
    if math.isnan(value):
        return ""
    shown = f"{column.scale * value:{column.form}}"
    spread = "" if error is None else f"{column.scale * error:{column.form}}"
    if spread.strip("0."):
        shown += f" ± {spread}"
    return shown if is_met(column.asked, value) else f"**{shown}**"


def scaled(column: Column) -> str:
    """What is asked of a figure, as it is shown."""
    return re.sub(r"[\d.]+", lambda found: f"{column.scale * float(found[0]):g}", column.asked)


def table_of(kind: str, rows: Mapping[str, Row]) -> str:
    """The table of a kind: a line per row, one of all runs if that is asked for, what is asked, and the commits.

    The number of runs and the outcome are below the table where all rows have the same.
    """
    of, own = KINDS[kind], {case: rows[case.name] for case in CASES if case.kind == kind and case.name in rows}
    if not own:
        return "Not measured."
    first, columns = len(of.heads), of.columns
    lines = [[*of.heads, "n", "outcome", *(column.title for column in columns)]]
    for case, row in own.items():
        counts = Counter(row["outcomes"]).most_common()
        ended = ", ".join(f"{count} {name}" if len(counts) > 1 else name for name, count in counts)
        cells = [*case.setting, *[""] * (first - len(case.setting)), str(row.get("n", len(row["seeds"]))), ended]
        lines.append([*cells, *(cell(column, row["values"]) for column in columns)])
    if of.pooled and len(own) > 1:
        names = {name for row in own.values() for name in row["values"]}
        every = {name: [v for row in own.values() for v in row["values"].get(name, ())] for name in names}
        count = str(sum(row.get("n", len(row["seeds"])) for row in own.values()))
        lines.append(["all", *[""] * (first - 1), count, "", *(cell(column, every) for column in columns)])
    alike = [k for k in (first, first + 1) if len({line[k] for line in lines[1:]}) == 1]
    notes = [f"{lines[0][k]}: {lines[1][k]}." for k in alike if lines[1][k]]
    lines = [[text for k, text in enumerate(line) if k not in alike] for line in lines]
    asked = [f"{column.title} {scaled(column)}" for column in columns if column.asked]
    commits = ", ".join(sorted({f"`{row['commit']}`" for row in own.values()}))
    notes += [*([f"Asked: {'; '.join(asked)}; bold is not as asked."] if asked else []), f"Code: {commits}."]
    return "\n\n".join([f"    python benchmarks/suite.py {kind}", markdown(lines, first), " ".join(notes)])


def markdown(lines: Sequence[Sequence[str]], text: int = 1) -> str:
    """A table whose first line holds the column names; the first `text` columns are words, the others numbers."""
    rule = ["---"] * text + ["---:"] * (len(lines[0]) - text)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (lines[0], rule, *lines[1:]))


PUBLISHED = {
    "intel": ("Intel Research Lab", "0.023 ± 0.024 m, 0.45°", "0.031 ± 0.026 m, 1.3°", "7.37 ± 14.3 m, 39°"),
    "fr079": ("Freiburg 079", "0.045 ± 0.035 m, 0.54°", "0.056 ± 0.042 m", "6.50 ± 13.7 m, 30°"),
    "aces": ("ACES, Austin", "0.038 ± 0.043 m, 0.37°", "0.044 ± 0.044 m", ""),
    "clinic": ("Freiburg clinic, 1.4 km", "0.108 ± 0.196 m", "0.143 ± 0.180 m", ""),
}
"""title, Cartographer (Hess et al. 2016), graph mapping (Kümmerle et al. 2009), raw odometry"""


def relations(rows: Mapping[str, Row], log: str) -> str:
    """Translation with its spread over the relations, and rotation."""
    names = ("trans_m_mean", "trans_m_std", "rot_deg_mean")
    m, spread, deg = (over_runs(name, rows[f"relations.{log}"]["values"])[0] for name in names)
    return f"{m:.3f} ± {spread:.3f} m, {deg:.2f}°"


def headline(rows: Mapping[str, Row]) -> str:
    """What the package reaches, in a line each."""
    explored = [row for name, row in rows.items() if name.startswith("explore.")]
    outcomes = [outcome for row in explored for outcome in row["outcomes"]]
    touched = sum(over_runs("collisions sum", row["values"])[0] for row in explored)
    least = min(over_runs("coverage min", row["values"])[0] for row in explored)
    done = f"{outcomes.count('explored')} of {len(outcomes)}, {touched:.0f} collisions, coverage at least {least:.3f}"

    def of(names: Sequence[str], figure: str, form: str, scale: float = 1.0) -> str:
        return ", ".join(cell(Column("", figure, form, "", scale), rows[name]["values"]) for name in names)

    tours = [f"tour.{scene}.ekf-invariant" for scene in ("apartment", "office")]
    logs = [f"relations.{log}" for log in ("intel", "fr079")]
    heading = of(["circle.ekf", "circle.ekf-invariant"], "nees_heading", ".2f")
    lines = [
        ["what, and what is published or consistent", "here"],
        *([f"{PUBLISHED[log][0]}, error of relations; Cartographer {PUBLISHED[log][1]}", relations(rows, log)]
          for log in ("intel", "fr079")),
        [f"explorations of {len(explored)} scenes", done],
        ["tours of apartment and office: position error, mm", of(tours, "ate_m", ".1f", 1e3)],
        ["the same: pose NEES; 3 is consistent", of(tours, "nees", ".2f")],
        ["landmark circle: heading NEES of `ekf`, `ekf-invariant`; 1 is consistent, `ekf` 2.88 over 200 runs", heading],
        ["Victoria Park: graph error of `isam2` over GTSAM's", of(["victoria"], "graph_error_ratio", ".4f")],
        ["replay of the two logs, times real time", of(logs, "times_real_time", ".0f")],
    ]  # fmt: skip
    return markdown(lines, 2)


def beside_others(rows: Mapping[str, Row]) -> str:
    """Each log here and as others published it."""
    heads = ["log", "here, defaults", "Cartographer", "graph mapping", "raw odometry"]
    return markdown([heads, *([title, relations(rows, log), *rest] for log, (title, *rest) in PUBLISHED.items())])


def written(page: str, rows: Mapping[str, Row]) -> str:
    """A page with the tables between its markers; ValueError for a marker of no table, or without its end."""
    made = {"headline": headline, "beside others": beside_others}
    parts = page.split("<!-- table: ")
    for k, part in enumerate(parts[1:], start=1):
        name, _, rest = part.partition(" -->")
        _, end, after = rest.partition(f"<!-- end of {name} -->")
        if not end or (name not in made and name not in KINDS):
            raise ValueError(f"markers: found {name!r}, allowed: {', '.join([*made, *KINDS])}, each with its end")
        text = made[name](rows) if name in made else table_of(name, rows)
        parts[k] = f"{name} -->\n\n{text}\n\n{end}{after}"
    return "<!-- table: ".join(parts)


def write_pages(rows: Mapping[str, Row]) -> None:
    """Put the tables into the pages."""
    for page in PAGES:
        page.write_text(written(page.read_text(encoding="utf-8"), rows), encoding="utf-8")


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # a time limit's; ends the processes
    sys.exit(main())
