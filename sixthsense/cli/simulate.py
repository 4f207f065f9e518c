"""`sixthsense simulate`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli.common import Common, announce, parse_command, refuse, show_help, wants_help
from sixthsense.cli.exits import EXIT_CODES, FAILED
from sixthsense.cli.live import OnNetwork
from sixthsense.cli.options import UsageError
from sixthsense.cli.shown import arg, positional
from sixthsense.sources.scene_files import scene_file


@dataclass(frozen=True)
class Simulate(OnNetwork, Common):
    """Simulate a robot on a ROS 2 network, in real time: it sends /scan and /odom, and is driven by /cmd_vel.

    With --task, --goal or --tour it drives by itself, and ignores commands.
    """

    scene: Annotated[str | None, positional(), arg(metavar="[SCENE]")] = None
    """Shipped scene, or a .toml, map_server .yaml, .scn file."""
    timeout: Annotated[float, arg(metavar="S")] = 0.3
    """A command moves the robot for at most this long, s."""
    late: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of scans sent up to 0.5 s late."""
    lost: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of scans that are not sent."""
    twice: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of scans that are sent twice."""
    cmd_vel_stamped: bool = False
    """Take commands as geometry_msgs/TwistStamped. By default as Twist."""
    truth: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the true trajectory. TUM format, with the stamps of the messages."""


_OF_A_RECORD = ("out", "overwrite", "view", "bind", "verbose")


def command(args: list[str]) -> int:
    """Simulate a robot."""
    if wants_help(args):
        return show_help(Simulate, "simulate", "default", args, _OF_A_RECORD)
    options, flags = parse_command(Simulate, "scene", "default", args)
    _check_numbers(options)
    refuse(options, _OF_A_RECORD, "on a simulated robot, which keeps no record", "with live")
    config = options.settings
    if options.scene is not None and "scene" in flags:
        raise UsageError(f"--scene: found beside {options.scene!r}, allowed: one scene")
    if options.scene is not None:
        config = dataclasses.replace(config, scene=options.scene)
    scene_file(config.scene)
    network = options.network()
    from sixthsense.api import with_task
    from sixthsense.live.reading import TWIST, TWIST_STAMPED
    from sixthsense.live.simulated import Disturbance, SimulatedRobot, drive_by_commands
    from sixthsense.running.runs import Watch, simulate
    from sixthsense.running.warmup import prepare
    from sixthsense.sources.mission import mission
    from sixthsense.sources.scene import load_scene

    drives_itself = bool({"task", "goal", "tour"} & set(flags))
    config = with_task(config, flags, "--")
    scene = load_scene(config.scene, config.map_unknown)
    mission(scene, config)
    disturbance = Disturbance(options.late, options.lost, options.twice)
    commands = TWIST_STAMPED if options.cmd_vel_stamped else TWIST
    with SimulatedRobot(network, config, disturbance, None if drives_itself else commands) as robot:
        prepare(announce)
        robot.begin(options.truth)
        announce(f"a robot in {scene.name} sends /scan and /odom, domain {network.domain}; Ctrl-C ends it")
        if drives_itself:
            outcome = simulate(config, scene, None, Watch((robot.on_tick,), False, realtime=True)).outcome
        else:
            outcome = drive_by_commands(robot, config, scene, options.timeout)
    print(f"collisions: {int(outcome == 'collided')}")
    print(robot.summary())
    return EXIT_CODES.get(outcome, FAILED)


def _check_numbers(options: Simulate) -> None:
    """Raise UsageError for shares and times that are not allowed; the parser passes other text unchanged."""
    for name, most in (("late", 1.0), ("lost", 1.0), ("twice", 1.0), ("timeout", 60.0)):
        value = getattr(options, name)
        if not (isinstance(value, int | float) and 0.0 <= value <= most):
            raise UsageError(f"--{name}: found {value}, allowed: 0 to {most:g}")
