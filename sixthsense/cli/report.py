"""`sixthsense report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sixthsense.cli import DONE
from sixthsense.cli.common import announce, numbered
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config.errors import InputError

if TYPE_CHECKING:
    from sixthsense.figures.run import Run

_FILM = "animation.gif"


class Report(Options):
    """Draw the figures of finished or killed runs, and write report.html.

    The page has the figures, the metrics and the configuration. A killed run is shown up to its last record.

    The figures of one run are written to its own figures/. Several runs are drawn side by side, with a table of
    metrics.
    """

    folders: Annotated[tuple[str, ...], Arg("RUN_DIR ...", is_positional=True)] = ()
    """Folder of a run."""
    out: Annotated[Path | None, Arg("DIR")] = None
    """Folder to write; for several runs by default a new one under runs/."""
    overwrite: bool = False
    """Write into DIR if it exists."""
    animate: Annotated[str | None, Arg("[FILE]", without=_FILM)] = None
    """Film of one run, FILE.mp4 (needs ffmpeg), FILE.webp or FILE.gif; by default animation.gif beside the figures."""

    def run(self, flags: Table) -> int:
        """Draw the figures of runs."""
        folders, out = self.folders, self.out
        if not folders:
            raise InputError("folders", "found nothing", "folders of runs")
        if out is not None and out.exists() and not self.overwrite:
            raise InputError("out", f"{out} exists", "a new folder, or `overwrite`")
        from sixthsense.evaluation.measured_run import check_folders
        from sixthsense.figures.animation import check_film
        from sixthsense.figures.comparison import compare
        from sixthsense.figures.report import report
        from sixthsense.figures.run import load

        if self.animate is not None and len(folders) > 1:
            raise InputError("animate", f"found {len(folders)} runs", "one run")
        check_folders(folders)
        runs = [load(folder) for folder in folders]
        if self.animate is not None:
            check_film(self.animate, runs[0].trace)
        if out is None:
            out = Path(folders[0]) / "figures" if len(runs) == 1 else next(numbered("report"))
        files = report(runs, out)
        print(compare(runs).metrics().drop(columns="meaning").to_string())
        for run in runs:
            for part in run.missing:
                announce(f"note: {run.folder}: found no record of {part}")
        print(f"written to {out}/: {', '.join(file.name for file in files)}")
        if self.animate is not None:
            file = out / _FILM if self.animate == _FILM else Path(self.animate)
            _animate(runs[0], folders[0], file)
            print(f"written: {file}")
        return DONE


def _animate(run: Run, folder: str, film: Path) -> None:
    from tqdm import tqdm

    from sixthsense.figures.animation import MOST_FRAMES, animate
    from sixthsense.running.warmup import prepare

    prepare(announce)
    frames = min(MOST_FRAMES, len(run.trace.stamps_ns))
    with tqdm(total=frames, desc=film.name, disable=None, leave=False) as bar:
        animate(folder, run.trace, film, run.title, frames, bar.update)
