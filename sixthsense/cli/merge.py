"""`sixthsense merge`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from sixthsense.cli.common import Common, announce, live_view, parse_command, run_folder, show_end
from sixthsense.cli.options import arg, positional
from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.names import OF_THE_ROBOT


@dataclass(frozen=True)
class Merge(Common):
    """Map two runs in one building together: scans of both are aligned, in the frame of the first.

    The second run is found in the map of the first by what it has seen. The result is the folder of a run.
    """

    base: ClassVar[str] = "log"
    refused: ClassVar[tuple[str, ...]] = OF_THE_ROBOT

    runs: Annotated[tuple[str, ...], positional("RUN_A RUN_B")] = ()
    """The folders of the two runs."""
    relations: Annotated[Path | None, arg("FILE")] = None
    """Hand-checked relations between poses, the reference of the trajectory's error."""


def command(args: list[str]) -> int:
    """Merge two runs."""
    from sixthsense.sources.replay_input import LogSelection, check_options, check_out

    options, flags = parse_command(Merge, args, _base)
    first, second = options.runs
    check_options(first, flags, LogSelection())
    for run in options.runs:
        check_out(run, options.out)
    from sixthsense.running.merging import open_merged, replay_merged
    from sixthsense.running.runs import RunHooks

    announce(f"looking for {second} in the map of {first}")
    merged = open_merged(Path(first), Path(second), options.settings, options.relations)
    for note in merged.notes:
        announce(f"note: {note}")
    with run_folder(options, merged.config, merged.name, merged.files) as folder, live_view(options) as hooks:
        return show_end(replay_merged(merged, folder, RunHooks(hooks, say=announce)), options.verbose)


def _base(runs: tuple[str, ...] | None) -> str | Config:
    """The configuration of the first run; InputError for other than two, InputError for what is no folder of a run."""
    from sixthsense.sources.logs import is_run_folder
    from sixthsense.sources.replay_input import base_of

    if runs is None or len(runs) != 2:
        raise InputError("runs", f"found {' '.join(runs or ()) or 'nothing'}", "the folders of two runs")
    for run in runs:
        if not is_run_folder(Path(run)):
            found = "no config.toml in it" if Path(run).is_dir() else "no such folder"
            raise InputError(run, f"found {found}", "the folder of a run")
    return base_of(runs[0])
