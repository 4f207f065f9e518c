"""`sixthsense merge`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli.common import Common, announce, parse_command, run_folder, show_end, show_help, wants_help
from sixthsense.cli.options import UsageError
from sixthsense.cli.shown import arg, positional
from sixthsense.cli.view import live_view
from sixthsense.config import ConfigError
from sixthsense.config.names import OF_THE_ROBOT


@dataclass(frozen=True)
class Merge(Common):
    """Map two runs in one building together: scans of both are aligned, in the frame of the first.

    The second run is found in the map of the first by what it has seen. The result is the folder of a run.
    """

    runs: Annotated[str | None, positional(), arg(metavar="RUN_A RUN_B")] = None
    """The folders of the two runs, before all options."""
    relations: Annotated[Path | None, arg(metavar="FILE")] = None
    """Hand-checked relations between poses, the reference of the trajectory's error."""


def command(args: list[str]) -> int:
    """Merge two runs."""
    if wants_help(args):
        return show_help(Merge, "merge", "log", args, OF_THE_ROBOT)
    from sixthsense.sources.logs import is_run_folder
    from sixthsense.sources.replay_input import Chosen, base_of, check_options, check_out

    folders = args[:2]
    if len(folders) < 2 or any(run.startswith("-") for run in folders):
        raise UsageError(f"runs: found {' '.join(args[:2]) or 'nothing'}, allowed: the folders of two runs")
    for run in folders:
        if not is_run_folder(Path(run)):
            found = "no config.toml in it" if Path(run).is_dir() else "no such folder"
            raise ConfigError(f"{run}: found {found}, allowed: the folder of a run")
    options, flags = parse_command(Merge, "runs", base_of, [folders[0], *args[2:]])
    check_options(folders[0], flags, Chosen(), "--")
    for run in folders:
        check_out(run, options.out)
    from sixthsense.running.merging import open_merged, replay_merged
    from sixthsense.running.runs import Watch

    announce(f"looking for {folders[1]} in the map of {folders[0]}")
    merged = open_merged(Path(folders[0]), Path(folders[1]), options.settings, options.relations)
    for note in merged.notes:
        announce(f"note: {note}")
    with run_folder(options, merged.config, merged.name, merged.files) as folder, live_view(options) as hooks:
        return show_end(replay_merged(merged, folder, Watch(hooks, say=announce)), options.verbose)
