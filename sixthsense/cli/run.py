"""`sixthsense run`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

from sixthsense.cli.common import WithPriorMap, announce, parse_command, run_folder, show_end, show_help, wants_help
from sixthsense.cli.options import UsageError
from sixthsense.cli.shown import arg, positional
from sixthsense.cli.view import live_view
from sixthsense.config import is_of_replay
from sixthsense.sources.scene_files import scene_file


@dataclass(frozen=True)
class Run(WithPriorMap):
    """Simulate a robot in a scene unknown to it: it explores the scene, or drives to goals."""

    scene: Annotated[str | None, positional(), arg(metavar="[SCENE]")] = None
    """Shipped scene, or a file: .toml, map_server .yaml, .scn."""
    realtime: bool = False
    """Slow the simulation down to real time."""


def command(args: list[str]) -> int:
    """Simulate a scene."""
    if wants_help(args):
        return show_help(Run, "run", "default", args)
    options, flags = parse_command(Run, "scene", "default", args)
    config = options.settings
    if options.config is not None and is_of_replay(options.config):
        raise UsageError(f"--config: {options.config} is of a replay, allowed: sixthsense replay LOG --config FILE")
    if options.scene is not None and "scene" in flags:
        raise UsageError(f"--scene: found beside {options.scene!r}, allowed: one scene")
    if options.scene is not None:
        config = dataclasses.replace(config, scene=options.scene)
    scene_file(config.scene)
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
