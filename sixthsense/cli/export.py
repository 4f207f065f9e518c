"""`sixthsense export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sixthsense.cli import DONE
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config.errors import InputError


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
        files = [run.to_bag(out / "bag")] if self.bag else []
        files += [run.to_g2o(out / "graph.g2o")] if self.g2o else []
        files += [run.to_gtsam(out / "graph.npz")] if self.gtsam else []
        files += run.to_tum(out) if self.tum else []
        files += run.to_csv(out) if self.csv else []
        print(f"written: {', '.join(map(str, files))}")
        return DONE
