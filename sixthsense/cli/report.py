"""`sixthsense report`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.cli.common import announce, numbered, wants_help
from sixthsense.cli.exits import DONE
from sixthsense.cli.options import UsageError

if TYPE_CHECKING:
    from sixthsense.figures.report import Form
    from sixthsense.figures.run import Run

USAGE = """\
usage: sixthsense report RUN_DIR ... [--out DIR] [--overwrite] [--figures png|svg|pdf] [--animate [FILE.mp4|.webp|.gif]]

Draw the figures of finished or killed runs, and write report.html, a page with the figures, the metrics, the
configuration and the command that repeats the run. A killed run is shown up to its last record.

The figures of one run are written to its own figures/. Several runs are drawn side by side, with a table of metrics.
Of a campaign there are medians and bands over its runs, errors over time and distance, and the averaged NEES.

  RUN_DIR          folder of a run, or of a campaign
  --out DIR        folder to write; for several runs by default a new one under runs/
  --overwrite      write into DIR if it exists
  --figures FORM   svg or pdf: each figure as vector graphics, too; png (the default): bitmaps only
  --animate [FILE] film of one run, FILE.mp4 (needs ffmpeg), FILE.webp or FILE.gif; by default animation.gif
                   beside the figures
"""

OWN = {"out": Path, "overwrite": bool, "figures": str, "animate": Path}

_FILM = "animation.gif"


def command(args: list[str]) -> int:
    """Draw the figures of runs."""
    if wants_help(args):
        print(USAGE, end="")
        return DONE
    from sixthsense.cli.options import OptionalValue, parse_positionals

    film = OptionalValue(None, _is_film, "FILE.mp4, FILE.webp or FILE.gif")
    folders, given = parse_positionals(args, {**OWN, "animate": film})
    if not folders:
        raise UsageError("run: found nothing, allowed: folders of runs, or of a campaign")
    out: Path | None = given.get("out")
    if out is not None and out.exists() and not given.get("overwrite", False):
        raise UsageError(f"--out: {out} exists, allowed: a new folder, or --overwrite")
    from sixthsense.evaluation.measured_run import check_folders
    from sixthsense.figures.animation import check_film
    from sixthsense.figures.report import as_form, compact, report
    from sixthsense.figures.run import load

    form = as_form(given.get("figures", "png"))
    if any((Path(folder) / "campaign.toml").is_file() for folder in folders):
        return _report_campaign(folders, out, form, given)
    if "animate" in given:
        check_film(_FILM if given["animate"] is None else given["animate"])
        if len(folders) > 1:
            raise UsageError(f"--animate: found {len(folders)} runs, allowed: one run")
    check_folders(folders, "the folder of a run or of a campaign")
    runs = [load(folder) for folder in folders]
    if out is None:
        out = Path(folders[0]) / "figures" if len(runs) == 1 else next(numbered("report"))
    files = report(runs, out, form)
    print(compact(runs))
    for run in runs:
        for part in run.missing:
            print(f"note: {run.folder}: found no record of {part}", file=sys.stderr)
    print(f"written to {out}/: {', '.join(file.name for file in files)}")
    if "animate" in given:
        file = out / _FILM if given["animate"] is None else Path(given["animate"])
        _animate(runs[0], folders[0], file)
        print(f"written: {file}")
    return DONE


def _report_campaign(folders: list[str], out: Path | None, form: Form, given: dict[str, Any]) -> int:
    """Draw the figures of one campaign."""
    if len(folders) > 1:
        raise UsageError(f"run: found a campaign among {len(folders)} folders, allowed: one campaign alone, or runs")
    if "animate" in given:
        raise UsageError("--animate: found with a campaign, allowed: with one run")
    from sixthsense.campaigns import Campaign
    from sixthsense.campaigns.report import report_campaign
    from sixthsense.evaluation.tables import text_table

    out = Path(folders[0]) / "figures" if out is None else out
    files = report_campaign(folders[0], out, form)
    print(text_table(Campaign(folders[0]).summary()))
    print(f"written to {out}/: {', '.join(file.name for file in files)}")
    return DONE


def _is_film(argument: str) -> bool:
    """Whether an argument after `--animate` is its value and not the folder of a run."""
    return bool(Path(argument).suffix) and not Path(argument).is_dir()


def _animate(run: Run, folder: str, film: Path) -> None:
    from tqdm import tqdm

    from sixthsense.figures.animation import MOST_FRAMES, animate
    from sixthsense.running.warmup import prepare

    prepare(announce)
    frames = min(MOST_FRAMES, len(run.trace.stamps_ns))
    with tqdm(total=frames, desc=film.name, disable=None, leave=False) as bar:
        animate(folder, run.trace, film, run.title, frames, bar.update)
