"""`sixthsense replay`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli.common import WithPriorMap, announce, parse_command, run_folder, show_end, show_help, wants_help
from sixthsense.cli.options import UsageError
from sixthsense.cli.shown import arg, positional
from sixthsense.cli.view import live_view
from sixthsense.config.names import OF_THE_ROBOT


@dataclass(frozen=True)
class Replay(WithPriorMap):
    """Process a recorded log.

    CARMEN (.log, .clf) or a graph of landmarks (.graph, .g2o, .toro, .txt), plain, .gz or .bz2; a ROS 1 or ROS 2 bag;
    the folder of a run; an MRCLAM folder.
    """

    log: Annotated[str | None, positional(), arg(metavar="LOG")] = None
    """The log."""
    relations: Annotated[Path | None, arg(metavar="FILE")] = None
    """Hand-checked relations between poses, to measure errors. They are those of Kuemmerle et al. 2009."""
    topic: Annotated[str | None, arg(metavar="NAME[,NAME]")] = None
    """Topics to use from a bag with several topics of scans or odometry."""
    odometry_frames: Annotated[str | None, arg(metavar="P,C")] = None
    """Frames of odometry in /tf, such as odom,base_link. Without a topic of odometry they are found."""
    robot: Annotated[int | None, arg(metavar="N")] = None
    """Robot to use from an MRCLAM folder with several."""


def command(args: list[str]) -> int:
    """Replay a log."""
    if wants_help(args):
        return show_help(Replay, "replay", "log", args, OF_THE_ROBOT)
    from sixthsense.sources.replay_input import Chosen, base_of, check_options, check_out, open_recorded

    options, flags = parse_command(Replay, "log", base_of, args)
    topics, frames = (tuple(given.split(",")) if given else () for given in (options.topic, options.odometry_frames))
    chosen = Chosen(topics, options.robot, frames)
    check_options(options.log, flags, chosen, "--")
    if options.log is None:
        raise UsageError(
            "log: found nothing, allowed: a CARMEN file, a graph, a bag, the folder of a run, an MRCLAM folder"
        )
    check_out(options.log, options.out)
    from sixthsense.running.runs import Watch, replay_log

    prior = options.prior_start()
    stated = [name.replace("-", "_") for name in flags.get("laser", {})]
    found = open_recorded(options.log, options.settings, options.relations, chosen, stated)
    for note in found.notes:
        print(f"note: {found.name}: {note}", file=sys.stderr)
    stem = f"{found.name.split('.')[0]}-{found.config.estimator}"
    with run_folder(options, found.config, stem, found.files, prior) as folder, live_view(options) as hooks:
        return show_end(replay_log(found, folder, Watch(hooks, say=announce), prior), options.verbose)
