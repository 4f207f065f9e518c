"""Commands that read what runs have left: `sixthsense export`, `report` and `audit`."""

import inspect
from pathlib import Path
from typing import Annotated, Literal

from sixthsense.cli import DONE, FAILED
from sixthsense.cli.common import announce, numbered
from sixthsense.cli.options import Arg, Options, Table, as_options
from sixthsense.config.errors import InputError

_FORMS = (".png", ".svg", ".pdf")
_FILM = "animation.gif"


class Export(Options):
    """Write the record of a finished or stopped run in the formats of other programs, into the run's folder."""

    folder: Annotated[str | None, Arg("RUN", is_positional=True)] = None
    """Folder of a run."""
    bag: bool = False
    """bag/, a ROS 2 bag with MCAP storage: scans, odometry, truth, estimates and plans."""
    g2o: bool = False
    """graph.g2o, the factor graph of poses, odometry, links and points, which GTSAM reads."""
    gtsam: bool = False
    """graph.npz, all of the factor graph as arrays, walls included."""
    tum: bool = False
    """estimate.tum, smoothed.tum and truth.tum."""
    csv: bool = False
    """trajectory.csv, landmarks.csv, and places_left.csv of an exploration."""
    out: Annotated[Path | None, Arg("DIR")] = None
    """Folder to write; by default that of the run."""

    def run(self, flags: Table) -> int:
        """Write the exports that were asked for."""
        if self.folder is None:
            raise InputError("folder", "found nothing", "the folder of a run")
        if not any((self.bag, self.g2o, self.gtsam, self.tum, self.csv)):
            raise InputError("export", "found no format", "`bag`, `g2o`, `gtsam`, `tum` or `csv`")
        from sixthsense.figures.run import load

        out = self.out or Path(self.folder)
        if self.bag and (out / "bag").exists():
            raise InputError("out", f"{out / 'bag'} exists", "a folder without a bag")
        run = load(self.folder)
        out.mkdir(parents=True, exist_ok=True)
        files: list[Path] = []
        for name, place in {"bag": out / "bag", "g2o": out / "graph.g2o", "gtsam": out / "graph.npz"}.items():
            files += [getattr(run, f"to_{name}")(place)] if getattr(self, name) else []
        files += run.to_tum(out) if self.tum else []
        files += run.to_csv(out) if self.csv else []
        print(f"written: {', '.join(map(str, files))}")
        return DONE


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
        if out is not None and out.exists() and not self.overwrite:
            raise InputError("out", f"{out} exists", "a new folder, or `overwrite`")
        if self.animate is not None and len(folders) > 1:
            raise InputError("animate", f"found {len(folders)} runs", "one run")
        from sixthsense.evaluation.measured_run import check_folders
        from sixthsense.figures.animation import MOST_FRAMES, animate, check_film
        from sixthsense.figures.comparison import compare
        from sixthsense.figures.report import report
        from sixthsense.figures.run import load

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
            from sixthsense.running.progress import progress_bar

            file, trace = out / _FILM if self.animate == _FILM else Path(self.animate), runs[0].trace
            frames = min(MOST_FRAMES, len(trace.stamps_ns))
            with progress_bar(None, total=frames, desc=file.name, leave=False) as bar:
                animate(folders[0], trace, file, runs[0].title, frames, bar.update)
            print(f"written: {file}")
        return DONE


class Audit(Options):
    """Compare the covariances of a system's poses with its errors.

    Poses of any system, with covariances, are compared with the truth. The answer is the NEES with its band, and the
    factor by which the covariance should be multiplied. Errors along a trajectory are correlated: band and interval
    come from the effective number of samples.
    """

    estimate: Annotated[tuple[str, ...], Arg("ESTIMATE ...", is_positional=True)] = ()
    """ROS bag with PoseWithCovarianceStamped or Odometry; TUM file with --covariance; folder of a run. Several are
    pooled as independent runs."""
    truth: Annotated[tuple[str, ...], Arg("FILE ...")] = ()
    """Bag, TUM file or folder of a run, one for each estimate. By default that of the run."""
    pair: Annotated[str | None, Arg("FILE")] = None
    """Without a truth: another system on the same drive, in the forms of ESTIMATE."""
    covariance: Annotated[tuple[str, ...], Arg("FILE ...")] = ()
    """Covariances of TUM files: in each line a stamp and the 6 or 21 numbers of the upper triangle. With --pair one for
    each system, the estimate's first."""
    topic: str = ""
    """Topic of the estimate in a bag, if there are several."""
    pair_topic: str = ""
    """Topic of the other systems; by default as --topic."""
    truth_topic: str = ""
    """Topic of the truth in a bag, if there are several."""
    frame: Literal["world", "body"] | None = None
    """Whose axes the covariances have; by default the world's, as ROS has it."""
    order: Literal["translation", "rotation"] = "translation"
    """Which comes first in a covariance."""
    align: Literal["none", "all"] | None = None
    """none, the default without --pair. all: by all poses, the degrees of freedom are taken off."""
    time_offset: float = 0.0
    """Seconds to add to the stamps of the estimate."""
    same_start: bool = False
    """Both begin together, by other clocks: stamps count from the first pose of each."""
    figure: Path | None = None
    """Draw errors in their 3-sigma tubes, NEES with its band and chi-square Q-Q: .png, .svg or .pdf."""
    numbers: Annotated[Path | None, Arg("FILE", flag="json")] = None
    """Write all numbers; a page with figures for a file that ends in .html."""
    overwrite: bool = False
    """Replace these files if they exist."""
    require: Literal["consistent"] | None = None
    """Exit code 1 unless the verdict is consistent."""

    def run(self, flags: Table) -> int:
        """Audit the covariances of a system's poses."""
        if not self.estimate:
            raise InputError("estimate", "found nothing", "a bag, a TUM file or the folder of a run, before `truth`")
        for name, file in (("json", self.numbers), ("figure", self.figure)):
            if file is not None and file.exists() and not self.overwrite:
                raise InputError(name, f"{file} exists", "a new file, or `overwrite`")
        if self.figure is not None and self.figure.suffix.lower() not in _FORMS:
            raise InputError("figure", f"found {str(self.figure)!r}", f"a file that ends in {', '.join(_FORMS)}")
        from sixthsense.auditing.call import audit

        given = self.model_dump(include=set(inspect.signature(audit).parameters) - {"estimate"})
        lists = {"truth": list(self.truth) or None, "covariance": list(self.covariance) or None}
        found = audit(self.estimate[0] if len(self.estimate) == 1 else list(self.estimate), **{**given, **lists})
        print(as_options(str(found)))
        if self.numbers is not None:
            found.save(self.numbers)
            print(f"written: {self.numbers}")
        if self.figure is not None:
            found.plot().savefig(self.figure, dpi=150)
            print(f"written: {self.figure}")
        return FAILED if self.require and found.outcome != self.require else DONE
