"""`sixthsense replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from sixthsense.cli.common import WithPriorMap, announce, live_view, parse_command, run_folder, show_end
from sixthsense.cli.options import arg, positional
from sixthsense.config.errors import InputError
from sixthsense.config.names import OF_THE_ROBOT


@dataclass(frozen=True)
class Replay(WithPriorMap):
    """Process a recorded log.

    CARMEN (.log, .clf) or a graph of landmarks (.graph, .g2o, .toro, .txt), plain, .gz or .bz2; a ROS 1 or ROS 2 bag;
    the folder of a run; an MRCLAM folder.
    """

    base: ClassVar[str] = "log"
    refused: ClassVar[tuple[str, ...]] = OF_THE_ROBOT

    log: Annotated[str | None, positional("LOG")] = None
    """The log."""
    relations: Annotated[Path | None, arg("FILE")] = None
    """Hand-checked relations between poses, to measure errors. They are those of Kuemmerle et al. 2009."""
    topics: Annotated[str | None, arg("NAME[,NAME]")] = None
    """Topics to use from a bag with several topics of scans or odometry."""
    odometry_frames: Annotated[str | None, arg("P,C")] = None
    """Frames of odometry in /tf, such as odom,base_link. Without a topic of odometry they are found."""
    units: Annotated[str | None, arg("WHAT=UNIT")] = None
    """Units of a log without metres and radians: ranges=mm,odometry=cm,angles=degrees,headings=degrees."""
    robot: Annotated[int | None, arg("N")] = None
    """Robot to use from an MRCLAM folder with several."""


def command(args: list[str]) -> int:
    """Replay a log."""
    from sixthsense.sources.replay_input import LogSelection, base_of, check_options, check_out, open_recorded

    options, flags = parse_command(Replay, args, base_of)
    given = options.topics, options.odometry_frames, options.units
    topics, frames, units = (tuple(words.split(",")) if words else () for words in given)
    chosen = LogSelection(topics, options.robot, frames, units)
    check_options(options.log, flags, chosen)
    if options.log is None:
        raise InputError("log", "found nothing", "a CARMEN file, a graph, a bag, the folder of a run, an MRCLAM folder")
    check_out(options.log, options.out)
    from sixthsense.running.runs import RunHooks, replay_log

    prior = options.prior_start()
    found = open_recorded(options.log, options.settings, options.relations, chosen)
    for note in found.notes:
        announce(f"note: {found.name}: {note}")
    stem = f"{found.name.split('.')[0]}-{found.config.estimator}"
    with run_folder(options, found.config, stem, found.files, prior) as folder, live_view(options) as hooks:
        return show_end(replay_log(found, folder, RunHooks(hooks, say=announce), prior), options.verbose)
