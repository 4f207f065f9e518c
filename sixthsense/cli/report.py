"""`sixthsense report`."""

from __future__ import annotations

from pathlib import Path

from sixthsense.cli.common import announce_compilation, numbered, wants_help
from sixthsense.cli.exits import DONE
from sixthsense.cli.options import UsageError

USAGE = """\
usage: sixthsense report RUN_DIR ... [--out DIR] [--overwrite]

Draw figures of runs that are over, killed ones included, as far as they got.

One run gets them into its own figures/; of several, they come side by side, with a table of their metrics.

  RUN_DIR        folder of a run
  --out DIR      folder to write; for several runs by default a new one under runs/
  --overwrite    write into DIR though it exists
"""


def command(args: list[str]) -> int:
    """Draw the figures of runs."""
    if wants_help(args):
        print(USAGE, end="")
        return DONE
    from sixthsense.cli.options import words

    folders, given = words(args, {"out": Path, "overwrite": bool})
    if not folders:
        raise UsageError("run: found nothing, allowed: one or more folders of runs")
    out: Path | None = given.get("out")
    if out is not None and out.exists() and not given.get("overwrite", False):
        raise UsageError(f"--out: {out} exists, allowed: a new folder, or --overwrite")
    from sixthsense.report import check_folders, compact, load_run, report, table

    check_folders(folders)
    announce_compilation()
    runs = [load_run(folder) for folder in folders]
    if out is None:
        out = Path(folders[0]) / "figures" if len(runs) == 1 else numbered("report")
    files = report(runs, out)
    print(compact(table(runs)))
    print(f"written to {out}/: {', '.join(file.name for file in files)}")
    return DONE
