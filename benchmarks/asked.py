"""Commands whose runs are kept, so that they resume, and tables of what is asked, what was measured, and if it is met.

The figures of each run are a row of a file named after the code's commit. A part begins no run after so many minutes;
the same command goes on.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from harness import (
    CACHE,
    PACKAGE,
    Figures,
    check_at_least,
    code_commit,
    finish,
    mean_and_error,
    print_table,
    single_threaded,
)
from tqdm import tqdm

from sixthsense.campaigns.engine import Processes, Rows, carry_out
from sixthsense.running.warmup import warm_up, warm_up_scans

PART_MIN = 8.0
"""minutes of a part of a long command"""
Found = Mapping[str, Figures]
"""figures by the key of their case"""


class Case(NamedTuple):
    """One run."""

    kind: str
    setting: tuple[str, ...]
    seed: int = 0

    @property
    def key(self) -> str:
        """Its name in the JSON."""
        return ".".join((self.kind, *self.setting, str(self.seed)))


class Line(NamedTuple):
    """A line of the table."""

    what: str
    asked: str
    measured: str
    met: str


Judge = Callable[[Sequence[Figures]], tuple[str, bool]]
"""From the figures of the runs of a line to what is shown, and whether it is as asked."""


def line(what: str, asked: str, runs: Sequence[Figures | None], judge_runs: Judge) -> Line:
    """A line of the table from its runs, of which None was not measured."""
    known = [found for found in runs if found is not None]
    if len(known) < len(runs):
        return Line(what, asked, "", "")
    for found in known:
        if "failed" in found:
            return Line(what, asked, found["failed"], "NO")
    shown, is_met = judge_runs(known)
    return Line(what, asked, shown, "yes" if is_met else "NO")


def within(name: str, low: float, high: float, runs: Sequence[Figures]) -> tuple[str, bool]:
    """A judge of the mean of a figure over runs, with its standard error."""
    mean, error = mean_and_error([found[name] for found in runs])
    shown = f"{mean:.3g}" if error is None else f"{mean:.3g} ± {error:.2g}"
    return shown, low <= mean <= high


def parsed(parser: argparse.ArgumentParser, minutes: float = PART_MIN, **bounds: float) -> argparse.Namespace:
    """The options of a command whose runs are kept: those of all such commands, and those that `parser` has already.

    `minutes` are those of a part, `bounds` the least values of the parser's own options.
    """
    parser.add_argument("--rows", nargs="+", default=[], metavar="KEY", help="runs whose key begins so (all); none")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--minutes", type=float, default=minutes, metavar="M", help=f"begin no run after ({minutes:g})")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1, minutes=0.0, **bounds)
    return options


def warm() -> None:
    """Compile the hot loops, once in each process, and use one thread for BLAS."""
    single_threaded()
    warm_up()
    warm_up_scans()


def measure(
    chosen: Sequence[Case],
    figures_of: Callable[[Case], Figures],
    options: argparse.Namespace,
    commit: str,
    alone: Callable[[Case], bool] = lambda case: False,
) -> dict[str, Figures]:
    """The figures by key of the cases that are known, or begun within `options.minutes`, by `options.jobs` processes.

    Those that are to run `alone` come first, one after the other. One that raises has what it raised, and is not kept.
    """
    rows, until = Rows(CACHE / f"{commit}.jsonl"), time.time() + 60.0 * options.minutes
    made, wanted = rows.read(), {case.key for case in chosen}
    for is_alone in (True, False):
        due = {case.key: case for case in chosen if alone(case) == is_alone and case.key not in made}
        if not due:
            continue
        if is_alone:
            warm()  # into the cache that commands read
        with (
            Processes(1 if is_alone else options.jobs, warm) as pool,
            tqdm(total=len(due), unit=" runs", disable=None, leave=False) as bar,
        ):
            for key, future in carry_out(pool, figures_of, due, until):
                if (error := future.exception()) is not None:
                    made[key] = {"failed": f"{type(error).__name__}: {error}".splitlines()[0], "commit": commit}
                else:
                    made[key] = {"key": key, "commit": commit, **future.result()}
                    rows.add(made[key])
                bar.update()
    return {key: {k: v for k, v in row.items() if k != "key"} for key, row in made.items() if key in wanted}


def selected(every: Sequence[Case], prefixes: Sequence[str]) -> list[Case]:
    """The cases whose key begins with one of `prefixes`, all without one; ValueError for one that selects nothing."""
    for prefix in prefixes:
        if prefix != "none" and not any(case.key.startswith(prefix) for case in every):
            kinds = ", ".join(dict.fromkeys(case.kind for case in every))
            raise ValueError(f"--rows: found {prefix!r}, allowed: none, and beginnings of keys of {kinds}")
    return [case for case in every if not prefixes or case.key.startswith(tuple(prefixes))]


def code_of(*modules: str) -> tuple[str, ...]:
    """What figures depend on: the package, and modules of this folder."""
    return (*PACKAGE, *(f"benchmarks/{name}.py" for name in modules))


def resumable(work: Callable[[], int]) -> int:
    """The exit code of a command whose runs are kept; wrong input and an interrupt are told in one line."""
    name = Path(sys.argv[0]).name
    try:
        return work()
    except (ValueError, RuntimeError) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the same command resumes", file=sys.stderr)
        return 130


def tabulate(
    name: str,
    options: argparse.Namespace,
    every: Sequence[Case],
    figures_of: Callable[[Case], Figures],
    lines: Callable[[Found], Iterable[Line]],
    code: Sequence[str],
) -> int:
    """Measure the cases that `options` select and print their table, which is kept as `name` if it is whole."""
    chosen = selected(every, options.rows)
    found = measure(chosen, figures_of, options, code_commit(code))
    table = [Line._fields, *(each for each in lines(found) if each.measured)]
    if left := len(chosen) - len(found):
        print(f"{left} runs are left; the same command goes on", file=sys.stderr)
    if options.keep and (left or options.rows):
        print_table(table)
        raise ValueError("--keep: nothing is kept of a part")
    finish(options, name, table, text=4)
    return 0
