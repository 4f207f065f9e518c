"""`sixthsense calibrate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli import DONE
from sixthsense.cli.common import OfScene, announce, parse_command
from sixthsense.cli.options import arg
from sixthsense.config.errors import InputError


@dataclass(frozen=True)
class Calibrate(OfScene):
    """Measure the robot's noise against the truth, and write it as a configuration for `run --config`."""

    out: Annotated[Path | None, arg("FILE")] = None
    """TOML file to write, a partial configuration; its figure is written beside it as .png."""
    overwrite: bool = False
    """Replace the file and its figure if they exist."""
    samples: int = 100
    """Samples of motion, one every half second."""

    @classmethod
    def main(cls, args: list[str]) -> int:
        """Measure the robot's noise."""
        options, flags = parse_command(Calibrate, args)
        if options.out is None:
            raise InputError("out", "found nothing", "a file to write, such as noise.toml")
        config = options.settings_of_scene(flags)
        from tqdm import tqdm

        from sixthsense.evaluation.calibrate import calibrate, check_output, summary
        from sixthsense.figures.calibration import write_calibration
        from sixthsense.running.warmup import prepare

        check_output(options.out, options.overwrite)
        prepare(announce)
        with tqdm(total=options.samples, desc="calibrate", unit=" samples", disable=None, leave=False) as bar:
            found = calibrate(config, options.samples, bar.update)
        title = f"calibration · {Path(config.scene).stem} · {config.preset} · seed {config.seed}"
        write_calibration(found, config, options.out, title)
        print("\n".join(summary(found)))
        print(f"written to {options.out} and {options.out.with_suffix('.png')}")
        return DONE
