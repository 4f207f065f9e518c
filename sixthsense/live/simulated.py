"""A simulated robot on the network, in real time: it sends what a real one sends, and stops without commands."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Self, TextIO

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import sweep_ns
from sixthsense.core.source import Command, Tick
from sixthsense.live.network import LATCHED, RELIABLE, Network, Node, Topic
from sixthsense.live.reading import TRANSFORMS, TWIST, MessageReader
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.record.exports import tum_line
from sixthsense.record.messages import LASER, ROBOT, Messages
from sixthsense.simulation.mission import Mission

SCAN = Topic("/scan", LASER_SCAN, RELIABLE)
ODOM = Topic("/odom", ODOMETRY, RELIABLE._replace(depth=50))
CMD_VEL = Topic("/cmd_vel", TWIST, RELIABLE._replace(depth=1))
TF_STATIC = Topic("/tf_static", TRANSFORMS, LATCHED)
_ANNOUNCED_S = 0.5
"""A network has told who is in it this long after one has joined: it takes a few messages of it."""


class SimulatedRobot:
    """Sends the ticks of a simulated world as messages, stamped with this machine's clock. A context manager."""

    def __init__(self, network: Network, config: Config, is_driven: bool) -> None:
        """Join the network; `is_driven` by commands, or the robot drives by itself."""
        self._file: TextIO | None = None
        self._node = Node(network)
        self.leak = self._node.leak
        """what is wrong with the confinement to this machine"""
        self._joined_s = time.monotonic()
        self._messages, self._reader = Messages(), MessageReader()
        self._subscribed = (CMD_VEL,) if is_driven else ()
        self._mount = Pose(*config.laser.mount)

    def begin(self, truth: Path | None = None) -> None:
        """Announce the topics; InputError if another robot or simulator has them.

        `truth` is a file for the true trajectory, OSError if it cannot be written.
        """
        time.sleep(max(0.0, self._joined_s + _ANNOUNCED_S - time.monotonic()))
        check_alone(self._node, (SCAN, ODOM), self._subscribed)
        self._scans, self._odometry = (self._node.writer(topic) for topic in (SCAN, ODOM))
        self._commands = [self._node.reader(topic) for topic in self._subscribed]
        self._file = None if truth is None else truth.open("w", encoding="utf-8")
        self._began_ns = time.time_ns()
        mount = self._messages.transform(self._began_ns, ROBOT, LASER, self._mount)
        self._node.writer(TF_STATIC).send(self._messages.serialized(mount, TRANSFORMS))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.close()
        if self._file is not None:
            self._file.close()

    def send(self, tick: Tick) -> None:
        """Send odometry, and a scan if there is one; write the truth."""
        stamp_ns, make = self._began_ns + tick.stamp_ns, self._messages
        self._odometry.send(make.serialized(make.odometry(stamp_ns, tick.odometry), ODOMETRY))
        if tick.scan is not None:
            begin_ns = stamp_ns + sweep_ns(len(tick.scan.ranges), tick.scan.time_increment)
            self._scans.send(make.serialized(make.scan(begin_ns, tick.scan), LASER_SCAN))
        if self._file is not None and tick.truth is not None:
            self._file.write(tum_line(stamp_ns, *tick.truth.array().tolist()))
            self._file.flush()

    def command(self) -> Command | None:
        """The newest command that has arrived since the last call; None without one that can be used."""
        found = None
        for reader in self._commands:
            for data in reader.take():
                with contextlib.suppress(ValueError):
                    found = self._reader.command(data, reader.topic.type)
        return found


def drive_by_commands(robot: SimulatedRobot, config: Config, task: Mission, timeout_s: float) -> str:
    """Let a robot be driven by the commands that it gets, each for at most a time; returns how it ended.

    That is "collided", "time is up" after `config.max_time`, or "interrupted".
    """
    world = task.world(config)
    period_s = config.robot.control_period_s
    command, commanded_s = Command(), time.monotonic()
    began_s, ticks = time.monotonic(), 0
    with deferred_interrupt() as interrupted:
        while not interrupted():
            if (new := robot.command()) is not None:
                command, commanded_s = new, time.monotonic()
            if time.monotonic() - commanded_s > timeout_s:
                command = Command()
            tick = world.step(command)
            if tick is None:
                return "collided"
            robot.send(tick)
            ticks += 1
            if config.max_time is not None and ticks * period_s > config.max_time:
                return "time is up"
            time.sleep(max(0.0, began_s + ticks * period_s - time.monotonic()))
    return "interrupted"


def check_alone(node: Node, published: tuple[Topic, ...], subscribed: tuple[Topic, ...]) -> None:
    """Raise InputError if another program publishes or subscribes to what a simulated robot is to have alone."""
    for topics, ends, what in ((published, node.publishers, "publisher"), (subscribed, node.subscribers, "subscriber")):
        for topic in topics:
            if ends(topic.name):
                allowed = "one robot or simulator in a network; `domain` N is another one"
                raise InputError(topic.name, f"found another {what}", allowed)
