"""`sixthsense calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sixthsense.cli import DONE
from sixthsense.cli.common import OfScene, announce
from sixthsense.cli.options import Arg, Table
from sixthsense.config.errors import InputError


class Calibrate(OfScene):
    """Measure the robot's noise against the truth, and write it as a configuration for `run --config`."""

    out: Annotated[Path | None, Arg("FILE")] = None
    """TOML file to write, a partial configuration; its figure is written beside it as .png."""
    overwrite: bool = False
    """Replace the file and its figure if they exist."""
    samples: int = 100
    """Samples of motion, one every half second."""

    def run(self, flags: Table) -> int:
        """Measure the robot's noise."""
        if self.out is None:
            raise InputError("out", "found nothing", "a file to write, such as noise.toml")
        config = self.settings_of_scene()
        from tqdm import tqdm

        from sixthsense.evaluation.calibrate import calibrate, check_output, summary
        from sixthsense.figures.calibration import write_calibration
        from sixthsense.running.warmup import prepare

        check_output(self.out, self.overwrite)
        prepare(announce)
        with tqdm(total=self.samples, desc="calibrate", unit=" samples", disable=None, leave=False) as bar:
            found = calibrate(config, self.samples, bar.update)
        title = f"calibration · {Path(config.scene).stem} · {config.preset} · seed {config.seed}"
        write_calibration(found, config, self.out, title)
        print("\n".join(summary(found)))
        print(f"written to {self.out} and {self.out.with_suffix('.png')}")
        return DONE
