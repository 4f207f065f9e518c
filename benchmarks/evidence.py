"""The headline tables: runs on seeds from 1,000 on, with the default configuration, into `evidence.json`.

Runs are kept and resumed as of `asked.py`, in parts of eight minutes. A row is measured again when the code has
changed, and recorded when all of its runs are there.

    python benchmarks/evidence.py                      # the next part; again until nothing is left
    python benchmarks/evidence.py --minutes 1000       # all parts
    python benchmarks/evidence.py --seeds-scale 0.1    # a tenth of the seeds
    python benchmarks/evidence.py --rows tour.office   # rows whose key begins so; others stay as they are
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

from asked import Case, code_of, measure, parsed, resumable
from evidence_rows import KINDS, ROWS, Row
from harness import EVIDENCE, Figures, arguments, code_commit, machine, rows_as_json, write_pages

CODE = code_of("evidence_rows", "tours")
"""what the figures depend on"""


def figures_of(case: Case) -> Figures:
    """The figures of a run."""
    return KINDS[case.kind](case.setting, case.seed)


def collected(row: Row, seeds: Sequence[int], runs: Sequence[Figures], commit: str) -> dict[str, Any]:
    """A row of the JSON; a figure that a run did not measure is None there."""
    names = dict.fromkeys(name for run in runs for name in run if name not in ("outcome", "commit"))
    values = {name: [_rounded(run.get(name)) for run in runs] for name in names}
    outcomes = [run["outcome"] for run in runs if "outcome" in run]
    return {
        "kind": row.kind, "setting": list(row.setting), "commit": commit, "seeds": list(seeds), "outcomes": outcomes,
        "values": values, "machine": machine(),
    }  # fmt: skip


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def selected(prefixes: Sequence[str]) -> list[Row]:
    """The rows whose key begins with one of `prefixes`, all without one, and whose data is there."""
    chosen = [row for row in ROWS if not prefixes or row.key.startswith(tuple(prefixes))]
    for row in chosen:
        if not row.is_possible():
            print(f"{row.key}: skipped, needs {row.needs} in SIXTHSENSE_DATA", file=sys.stderr)
    return [row for row in chosen if row.is_possible()]


def record(options: argparse.Namespace) -> int:
    """Measure the next part, and write the rows that are complete."""
    rows: dict[str, Any] = json.loads(EVIDENCE.read_text())["rows"] if EVIDENCE.exists() else {}
    commit, chosen = code_commit(CODE), selected(options.rows)
    seeds = {row.key: row.seed_list(options.seeds_scale) for row in chosen}
    cases = {row.key: [Case(row.kind, row.setting, seed) for seed in seeds[row.key]] for row in chosen}
    found = measure([case for own in cases.values() for case in own], figures_of, options, commit)
    made = {}
    for row in chosen:
        runs = [found[case.key] for case in cases[row.key] if case.key in found]
        for failed in (run["failed"] for run in runs if "failed" in run):
            raise RuntimeError(f"{row.key}: {failed}")
        if len(runs) == len(seeds[row.key]):
            made[row.key] = collected(row, seeds[row.key], runs, commit)
    rows |= made
    EVIDENCE.write_text(rows_as_json({row.key: rows[row.key] for row in ROWS if row.key in rows}))
    write_pages()
    left = [row.key for row in chosen if row.key not in made]
    print(f"{len(made)} of {len(chosen)} rows of {commit}; left for the same command: {', '.join(left) or 'none'}")
    return 0


def main() -> int:
    parser = arguments(__doc__, may_keep=False)
    parser.add_argument("--seeds-scale", type=float, default=1.0, metavar="F", help="factor of the seeds per row (1)")
    options = parsed(parser, seeds_scale=0.0)
    return resumable(lambda: record(options))


if __name__ == "__main__":
    sys.exit(main())
