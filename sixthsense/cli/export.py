"""`sixthsense export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli import DONE
from sixthsense.cli.options import Options, arg, parse, positional
from sixthsense.config.errors import InputError


@dataclass(frozen=True)
class Export(Options):
    """Write the record of a finished or stopped run in the formats of other programs, into the run's folder."""

    run: Annotated[str | None, positional("RUN")] = None
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
    out: Annotated[Path | None, arg("DIR")] = None
    """Folder to write; by default that of the run."""

    @classmethod
    def main(cls, args: list[str]) -> int:
        """Write the exports that were asked for."""
        options = Export(**parse(args, Export)[0])
        if options.run is None:
            raise InputError("run", "found nothing", "the folder of a run")
        if not any((options.bag, options.g2o, options.gtsam, options.tum, options.csv)):
            raise InputError("export", "found no format", "`bag`, `g2o`, `gtsam`, `tum` or `csv`")
        from sixthsense.figures.run import load

        out = options.out or Path(options.run)
        if options.bag and (out / "bag").exists():
            raise InputError("out", f"{out / 'bag'} exists", "a folder without a bag")
        run = load(options.run)
        out.mkdir(parents=True, exist_ok=True)
        files = [run.to_bag(out / "bag")] if options.bag else []
        files += [run.to_g2o(out / "graph.g2o")] if options.g2o else []
        files += [run.to_gtsam(out / "graph.npz")] if options.gtsam else []
        files += run.to_tum(out) if options.tum else []
        files += run.to_csv(out) if options.csv else []
        print(f"written: {', '.join(map(str, files))}")
        return DONE
