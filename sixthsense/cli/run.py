"""`sixthsense run`."""

from __future__ import annotations

from dataclasses import dataclass

from sixthsense.cli.common import OfScene, WithPriorMap, announce, live_view, parse_command, run_folder, show_end
from sixthsense.config import is_of_replay
from sixthsense.config.errors import InputError


@dataclass(frozen=True)
class Run(WithPriorMap, OfScene):
    """Simulate a robot in a scene unknown to it: it explores the scene, or drives to goals."""

    realtime: bool = False
    """Slow the simulation down to real time."""


def command(args: list[str]) -> int:
    """Simulate a scene."""
    options, flags = parse_command(Run, args)
    if options.config is not None and is_of_replay(options.config):
        raise InputError("config", f"{options.config} is of a replay", "sixthsense replay LOG `config` FILE")
    config = options.settings_of_scene(flags)
    from sixthsense.api import with_task
    from sixthsense.running.runs import RunHooks, simulate
    from sixthsense.sources.mission import mission_of

    prior = options.prior_start()
    config, task = mission_of(with_task(config, flags))
    for note in task.scene.notes:
        announce(f"note: {task.scene.name}: {note}")
    with (
        run_folder(options, config, f"{task.scene.name}-{config.estimator}", prior=prior) as folder,
        live_view(options) as hooks,
    ):
        watch = RunHooks(hooks, realtime=options.realtime, say=announce)
        return show_end(simulate(config, task, folder, watch, prior), options.verbose)
