"""The headline tables: runs on seeds from 1,000 on, with the default configuration, into `evidence.json`.

Each run's figures are kept in a folder named after the code's commit, so that the same command resumes; a row is
measured again when the code has changed. A part begins no run after eight minutes; a row is recorded when all of its
runs are there.

    python benchmarks/evidence.py                      # the next part; again until nothing is left
    python benchmarks/evidence.py --minutes 1000       # all parts
    python benchmarks/evidence.py --seeds-scale 0.1    # a tenth of the seeds
    python benchmarks/evidence.py --rows tour.office   # rows whose key begins so; others stay as they are
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from evidence_rows import KINDS, ROWS, Figures, Row
from harness import CACHE, PACKAGE, PART_MIN, check_at_least, code_commit, kept, machine, pooled, rows_as_json
from tables import EVIDENCE, write_pages

from sixthsense.running.warmup import warm_up

CODE = (*PACKAGE, "benchmarks/evidence_rows.py", "benchmarks/tours.py")
"""what the figures depend on"""
CPU = "processor_s"
"""kept with a run's figures, to tell what the whole takes"""


class Due(NamedTuple):
    """One run of a row."""

    row: Row
    seed: int
    folder: Path

    @property
    def file(self) -> Path:
        """Where its figures are kept."""
        return self.folder / f"{self.row.key}-{self.seed}.json"


def measured(until: float, due: Due) -> Figures | None:
    """The figures of a run, from its file if it has been made before; None after the time `until`, s."""

    def make() -> Figures:
        began = time.process_time()
        found = KINDS[due.row.kind](due.row.setting, due.seed) | {CPU: time.process_time() - began}
        if found.get("outcome") == "interrupted":
            raise KeyboardInterrupt  # what a run cut short has measured is not kept
        return found

    return kept(due.file, make) if due.file.exists() or time.time() < until else None


def collected(row: Row, seeds: Sequence[int], runs: Sequence[Figures], commit: str) -> dict[str, Any]:
    """A row of the JSON; a figure that a run did not measure is None there."""
    names = dict.fromkeys(name for run in runs for name in run if name not in ("outcome", CPU))
    values = {name: [_rounded(run.get(name)) for run in runs] for name in names}
    outcomes = [run["outcome"] for run in runs if "outcome" in run]
    return {
        "kind": row.kind, "setting": list(row.setting), "commit": commit, "seeds": list(seeds), "outcomes": outcomes,
        "values": values, "machine": machine(),
    }  # fmt: skip


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def measure_rows(rows: Sequence[Row], scale: float, jobs: int, commit: str, minutes: float) -> dict[str, Any]:
    """The rows of the JSON by key that are complete after so many minutes, computed by `jobs` processes."""
    due = [Due(row, seed, CACHE / commit) for row in rows for seed in row.seed_list(scale)]
    function = partial(measured, time.time() + 60.0 * minutes)
    found = dict(zip(((d.row.key, d.seed) for d in due), pooled(function, due, jobs, warm_up), strict=True))
    made = {}
    for row in rows:
        seeds = row.seed_list(scale)
        runs = [own for seed in seeds if (own := found[row.key, seed]) is not None]
        if len(runs) == len(seeds):
            made[row.key] = collected(row, seeds, runs, commit)
    return made


def selected(prefixes: Sequence[str]) -> list[Row]:
    """The rows whose key begins with one of `prefixes`, all without one, and whose data is there."""
    chosen = [row for row in ROWS if not prefixes or row.key.startswith(tuple(prefixes))]
    for row in chosen:
        if not row.is_possible():
            print(f"{row.key}: skipped, needs {row.needs} in SIXTHSENSE_DATA", file=sys.stderr)
    return [row for row in chosen if row.is_possible()]


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", nargs="+", default=[], metavar="KEY", help="rows whose key begins so (all)")
    parser.add_argument("--seeds-scale", type=float, default=1.0, metavar="F", help="factor of the seeds per row (1)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--minutes", type=float, default=PART_MIN, metavar="M", help=f"of a part ({PART_MIN:g})")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1, seeds_scale=0.0, minutes=0.0)
    return options


def main() -> int:
    options = parse()
    rows: dict[str, Any] = json.loads(EVIDENCE.read_text())["rows"] if EVIDENCE.exists() else {}
    try:
        commit, chosen = code_commit(CODE), selected(options.rows)
        made = measure_rows(chosen, options.seeds_scale, options.jobs, commit, options.minutes)
    except RuntimeError as error:
        print(f"evidence.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("evidence.py: interrupted; the same command resumes", file=sys.stderr)
        return 130
    rows |= made
    EVIDENCE.write_text(rows_as_json({row.key: rows[row.key] for row in ROWS if row.key in rows}))
    write_pages()
    left = [row.key for row in chosen if row.key not in made]
    print(f"{len(made)} of {len(chosen)} rows of {commit}; left for the same command: {', '.join(left) or 'none'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
