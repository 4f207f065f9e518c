"""The headline tables: runs on seeds from 1,000 on, with the default configuration, into one JSON and two pages.

Each run's figures are kept in a folder named after the code's commit, so that the same command resumes; a row is
measured again when the code has changed. `evidence.json` has the figures of every run, and README.md and RESULTS.md
have tables rendered from it, between HTML comments.

    python benchmarks/evidence.py                      # all rows; about 25 minutes on two cores
    python benchmarks/evidence.py --seeds-scale 0.1    # a tenth of the seeds
    python benchmarks/evidence.py --rows tour.office   # rows whose key begins so; others stay as they are
    python benchmarks/evidence.py --render             # tables only
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evidence_rows import KINDS, ROWS, Figures, Row
from evidence_tables import placed, rendered
from harness import check_at_least, kept, machine, pooled

from sixthsense.running.warmup import warm_up

HERE = Path(__file__).resolve().parent
JSON = HERE / "evidence.json"
CACHE = HERE / ".evidence"
PAGES = {"readme": HERE.parent / "README.md", "results": HERE / "RESULTS.md"}
CODE = ("sixthsense", "scenes", "benchmarks/evidence_rows.py", "benchmarks/tours.py")
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


def code_commit(code: Sequence[str] = CODE) -> str:
    """The last commit that changed the code, with a hash of what is not committed; RuntimeError outside a clone."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words, "--", *code], cwd=HERE.parent, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"git: {done.stderr.strip() or 'failed'}, allowed: a clone of the repository")
        return done.stdout

    changed = git("diff", "HEAD")
    commit = git("log", "-1", "--format=%h", "--abbrev=10").strip()
    return f"{commit}+{hashlib.sha256(changed.encode()).hexdigest()[:6]}" if changed else commit


def measured(due: Due) -> Figures:
    """The figures of a run, from its file if it has been made before."""

    def make() -> Figures:
        began = time.process_time()
        found = KINDS[due.row.kind](due.row.setting, due.seed) | {CPU: time.process_time() - began}
        if found.get("outcome") == "interrupted":
            raise KeyboardInterrupt  # what a run cut short has measured is not kept
        return found

    return kept(due.file, make)


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


def measure_rows(rows: Sequence[Row], scale: float, jobs: int, commit: str) -> dict[str, dict[str, Any]]:
    """The rows of the JSON by key, computed by `jobs` processes."""
    folder = CACHE / commit
    due = [Due(row, seed, folder) for row in rows for seed in row.seed_list(scale)]
    found = dict(zip(((d.row.key, d.seed) for d in due), pooled(measured, due, jobs, warm_up), strict=True))
    made = {}
    for row in rows:
        seeds = row.seed_list(scale)
        made[row.key] = collected(row, seeds, [found[row.key, seed] for seed in seeds], commit)
    return made


def as_json(evidence: dict[str, Any]) -> str:
    """The JSON with a row per line."""
    rows = ",\n".join(f"  {json.dumps(key)}: {json.dumps(row)}" for key, row in evidence["rows"].items())
    return f'{{\n "rows": {{\n{rows}\n }}\n}}\n'


def write_pages(evidence: dict[str, Any]) -> None:
    """Put the tables of the evidence into README.md and RESULTS.md."""
    texts = rendered(evidence)
    for name, page in PAGES.items():
        page.write_text(placed(page.read_text(encoding="utf-8"), name, texts[name]), encoding="utf-8")


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
    parser.add_argument("--render", action="store_true", help="write the tables again, measure nothing")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1, seeds_scale=0.0)
    return options


def main() -> int:
    options = parse()
    evidence: dict[str, Any] = json.loads(JSON.read_text()) if JSON.exists() else {"rows": {}}
    if not options.render:
        began = time.perf_counter()
        try:
            commit = code_commit()
            made = measure_rows(selected(options.rows), options.seeds_scale, options.jobs, commit)
        except RuntimeError as error:
            print(f"evidence.py: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("evidence.py: interrupted; the same command resumes", file=sys.stderr)
            return 130
        kept = {row.key: evidence["rows"][row.key] for row in ROWS if row.key in evidence["rows"]}
        evidence = {"rows": kept | made}
        JSON.write_text(as_json(evidence))
        print(f"{len(made)} rows of {commit} in {(time.perf_counter() - began) / 60.0:.1f} minutes")
    write_pages(evidence)
    return 0


if __name__ == "__main__":
    sys.exit(main())
