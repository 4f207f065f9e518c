"""`sixthsense run`."""

from __future__ import annotations

from dataclasses import dataclass

from sixthsense.cli.common import OfScene, WithPriorMap, announce, live_view, parse_command, run_folder, show_end
from sixthsense.cli.options import UsageError
from sixthsense.config import is_of_replay


@dataclass(frozen=True)
class Run(WithPriorMap, OfScene):
    """Simulate a robot in a scene unknown to it: it explores the scene, or drives to goals."""

    realtime: bool = False
    """Slow the simulation down to real time."""


def command(args: list[str]) -> int:
    """Simulate a scene."""
    options, flags = parse_command(Run, args)
    if options.config is not None and is_of_replay(options.config):
        raise UsageError(f"--config: {options.config} is of a replay, allowed: sixthsense replay LOG --config FILE")
    config = options.settings_of_scene(flags)
    from sixthsense.api import with_task
    from sixthsense.running.runs import Watch, simulate
    from sixthsense.sources.mission import mission, with_people
    from sixthsense.sources.scene import load_scene

    prior = options.prior_start()
    config = with_task(config, flags, "--")
    scene = load_scene(config.scene, config.map_unknown)
    config = with_people(scene, config)
    mission(scene, config)
    with (
        run_folder(options, config, f"{scene.name}-{config.estimator}", prior=prior) as folder,
        live_view(options) as hooks,
    ):
        watch = Watch(hooks, realtime=options.realtime, say=announce)
        return show_end(simulate(config, scene, folder, watch, prior), options.verbose)
