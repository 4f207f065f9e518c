"""`sixthsense calibrate`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli.common import Common, announce, parse_command, refuse, show_help, wants_help
from sixthsense.cli.exits import DONE
from sixthsense.cli.options import UsageError
from sixthsense.cli.shown import arg, positional
from sixthsense.sources.scene_files import scene_file


@dataclass(frozen=True)
class Calibrate(Common):
    """Measure the robot's noise against the truth, and write it as a configuration for `run --config`."""

    scene: Annotated[str | None, positional(), arg(metavar="SCENE")] = None
    """Shipped scene, or a file: .toml, map_server .yaml, .scn."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """TOML file to write, a partial configuration; its figure is written beside it as .png."""
    overwrite: bool = False
    """Replace the file and its figure if they exist."""
    samples: int = 100
    """Samples of motion, one every half second."""


_OF_A_RUN = ("view", "bind", "verbose")


def command(args: list[str]) -> int:
    """Measure the robot's noise."""
    if wants_help(args):
        return show_help(Calibrate, "calibrate", "default", args, _OF_A_RUN)
    options, _ = parse_command(Calibrate, "scene", "default", args)
    refuse(options, _OF_A_RUN, "on a calibration", "with run")
    if options.out is None:
        raise UsageError("--out: found nothing, allowed: a file to write, such as noise.toml")
    if not isinstance(options.samples, int):  # the parser passes text that is not a number unchanged
        raise UsageError(f"--samples: found {options.samples!r}, allowed: a whole number")
    config = options.settings
    if options.scene is not None:
        config = dataclasses.replace(config, scene=options.scene)
    scene_file(config.scene)
    from tqdm import tqdm

    from sixthsense.evaluation.calibrate import calibrate, check_output, summary
    from sixthsense.figures.calibration import write_calibration
    from sixthsense.running.warmup import prepare

    check_output(options.out, options.overwrite)
    prepare(announce)
    with tqdm(total=options.samples, desc="calibrate", unit=" samples", disable=None, leave=False) as bar:
        found = calibrate(config, options.samples, bar.update)
    write_calibration(
        found, config, options.out, f"calibration · {Path(config.scene).stem} · {config.preset} · seed {config.seed}"
    )
    print("\n".join(summary(found)))
    print(f"written to {options.out} and {options.out.with_suffix('.png')}")
    return DONE
