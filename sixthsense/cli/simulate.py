"""`sixthsense simulate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli import EXIT_CODES, FAILED
from sixthsense.cli.common import OfScene, announce, parse_command
from sixthsense.cli.live import OnNetwork
from sixthsense.cli.options import arg
from sixthsense.config import Range


@dataclass(frozen=True)
class Simulate(OnNetwork, OfScene):
    """Simulate a robot on a ROS 2 network, in real time: it sends /scan and /odom, and is driven by /cmd_vel.

    With --task, --goal or --tour it drives by itself, and ignores commands.
    """

    timeout: Annotated[float, Range(0.0, 60.0), arg("S")] = 0.3
    """A command moves the robot for at most this long, s."""
    truth: Annotated[Path | None, arg("FILE")] = None
    """Write the true trajectory. TUM format, with the stamps of the messages."""


def command(args: list[str]) -> int:
    """Simulate a robot."""
    options, flags = parse_command(Simulate, args)
    config = options.settings_of_scene(flags)
    network = options.network()
    from sixthsense.api import with_task
    from sixthsense.live.reading import TWIST
    from sixthsense.live.simulated import SimulatedRobot, drive_by_commands
    from sixthsense.running.runs import RunHooks, simulate
    from sixthsense.running.warmup import prepare
    from sixthsense.sources.mission import mission_of

    drives_itself = bool({"task", "goal", "tour"} & set(flags))
    config, task = mission_of(with_task(config, flags))
    with SimulatedRobot(network, config, None if drives_itself else TWIST) as robot:
        prepare(announce)
        robot.begin(options.truth)
        announce(f"a robot in {task.scene.name} sends /scan and /odom, domain {network.domain}; Ctrl-C ends it")
        if drives_itself:
            outcome = simulate(config, task, None, RunHooks((robot.on_tick,), False, realtime=True)).outcome
        else:
            outcome = drive_by_commands(robot, config, task, options.timeout)
    print(f"collisions: {int(outcome == 'collided')}")
    print(robot.summary())
    return EXIT_CODES.get(outcome, FAILED)
