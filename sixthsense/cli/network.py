"""`sixthsense live` and `simulate`, which join a ROS 2 network."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from sixthsense.cli import EXIT_CODES, FAILED
from sixthsense.cli.common import OfScene, WithPriorMap, announce
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config import Config, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.live.network import LOOPBACK, Network, dds, domain_of_environment

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.loop.run import OnTick


class OnNetwork(Options):
    """Options of the commands that join a ROS 2 network."""

    domain: Annotated[int | None, Arg("N")] = None
    """Domain of the network, by default ROS_DOMAIN_ID, or 0."""
    interface: Annotated[str, Arg("NAME")] = LOOPBACK
    """Network interface to join, or its address. By default that of this machine alone."""

    def network(self) -> Network:
        """The network to join; InputError for what is not allowed, and for a missing Cyclone DDS."""
        domain = domain_of_environment() if self.domain is None else self.domain
        if os.environ.get("CYCLONEDDS_URI"):
            announce("CYCLONEDDS_URI is not used: `interface` is")
        dds("core")
        return Network(domain, self.interface)


class Live(OnNetwork, WithPriorMap):
    """Map with a robot on a ROS 2 network: subscribes to its laser and odometry, publishes /map, /tf and /pose."""

    base: ClassVar[str] = "log"
    refused: ClassVar[tuple[str, ...]] = ("scene", "start", "map_unknown", "world")

    scan: Annotated[str, Arg("TOPIC")] = "/scan"
    """Topic of the laser. Messages sensor_msgs/LaserScan."""
    odom: Annotated[str, Arg("TOPIC")] = "/odom"
    """Topic of the wheels' odometry. Messages nav_msgs/Odometry."""
    drive: bool = False
    """Drive the robot: explore, or drive to --goal. Keep an emergency stop at hand."""
    cmd_vel: Annotated[str, Arg("TOPIC")] = "/cmd_vel"
    """With --drive: topic of the commands. Messages geometry_msgs/Twist or TwistStamped, as the robot subscribes."""

    @classmethod
    def start(cls, given: Table) -> str | Config:
        """The preset of real robots; with landmarks in a filter where the robot is driven, which answers sooner.

        The final pass would keep every scan in memory until the end.
        """
        driven = {"estimator": "ekf-invariant", "front_end": "landmarks", "association": {"proposed_by": "estimate"}}
        return merge(preset("log"), {"scans": {"final_pass": False}, **(driven if given.get("drive") else {})})

    def run(self, flags: Table) -> int:
        """Run SLAM on a robot."""
        own = (f"laser.{name}" for name in flags.get("laser", {}) if name not in ("mount", "max_range", "mirrored"))
        network, config = self.network(), self.settings
        for name in (*(name for name in Live.refused if name in flags), *own, *["no_odometry"] * config.no_odometry):
            raise InputError(name, "found on a robot", "with run or replay")
        from sixthsense.live.session import Session, Topics, check_drive
        from sixthsense.record.store import prior_start
        from sixthsense.running.runs import RunHooks, reserved, run_live
        from sixthsense.running.warmup import prepare

        topics = Topics(self.scan, self.odom, self.cmd_vel).checked()
        if self.drive:
            check_drive(config)
        prior = prior_start(**self.prior())
        prepare(config, of_log=not self.drive)
        with Session(network, topics, config, announce) as session:
            session.configure(self.drive)
            source = {"scan": topics.scan, "odom": topics.odom}

            def run(on_tick: "OnTick", out: Path, overwrite: bool) -> "Run":
                with reserved(out, session.config, overwrite, source, prior) as folder:
                    return run_live(session, self.drive, folder, RunHooks(on_tick), prior)

            code = self.started(run, f"live-{config.estimator}")
            if counts := session.notices.summary():
                announce(f"dropped or happened: {counts}")
            return code


class Simulate(OnNetwork, OfScene):
    """Simulate a robot on a ROS 2 network, in real time: it sends /scan and /odom, and is driven by /cmd_vel.

    With --task, --goal or --tour it drives by itself, and ignores commands.
    """

    timeout: Annotated[float, Field(ge=0.0, le=60.0), Arg("S")] = 0.3
    """A command moves the robot for at most this long, s."""
    truth: Annotated[Path | None, Arg("FILE")] = None
    """Write the true trajectory. TUM format, with the stamps of the messages."""

    def run(self, flags: Table) -> int:
        """Simulate a robot."""
        network = self.network()
        from sixthsense.live.simulated import SimulatedRobot, drive_by_commands
        from sixthsense.loop.run import combined_hooks
        from sixthsense.running.progress import paced
        from sixthsense.running.runs import RunHooks, simulate
        from sixthsense.running.warmup import prepare
        from sixthsense.simulation.mission import mission_of

        drives_itself = bool({"task", "goal", "tour"} & set(flags))
        config, task = mission_of(self.settings)
        with SimulatedRobot(network, config, not drives_itself) as robot:
            if robot.leak:
                announce(f"interface: {robot.leak}")
            prepare()
            robot.begin(self.truth)
            announce(f"a robot in {task.scene.name} sends /scan and /odom, domain {network.domain}; Ctrl-C ends it")
            if drives_itself:
                hook = combined_hooks(lambda tick, _: robot.send(tick), paced())
                outcome = simulate(config, task, None, RunHooks(hook, progress=False)).outcome
            else:
                outcome = drive_by_commands(robot, config, task, self.timeout)
        print(f"collisions: {int(outcome == 'collided')}")
        return EXIT_CODES.get(outcome, FAILED)
