"""A live run: join the network, wait for the robot, run the loop with it."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Self

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown, shown_name
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Tick
from sixthsense.live.network import LATCHED, RELIABLE, SENSOR, Network, Node, Reader, Topic, checked_topic
from sixthsense.live.publishing import MAP, VERDICT, Commands, MapSender, diagnostics, first_look, publisher
from sixthsense.live.reading import (
    POSE,
    TRANSFORMS,
    TWIST,
    TWIST_STAMPED,
    LaserReader,
    MessageReader,
    Notices,
    RobotPose,
)
from sixthsense.live.robot import AheadPilot, LiveRobot, Received, Steering
from sixthsense.logs.log import described_laser
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, TransformTree
from sixthsense.loop.interrupt import is_command_ended, is_ended_by_ctrl_c
from sixthsense.loop.run import OnTick, combined_hooks, recorded_drive
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.trace import Trace
from sixthsense.slam.prior_map import PriorStart

ENDED_BY_USER = "ended by the user"
"""outcome of a run that was ended by Ctrl-C, which is how it is to end"""

_SHOWN = 12  # frames in a message
_WAIT_S = 0.05
_HINT_S = 10.0  # without a message, until the user is told where else to look
_FRAMES_S = 1.0  # who sends static transforms is known by then, or there is nobody
_SENT_S = 5.0  # static transforms have come by then: Fast DDS offers what it has sent before every 3 s
_PERIODS = 5  # between scans, that the laser's rate is measured by
_RESPONSE_S = 0.1  # within which a robot follows a command: the time between two control ticks of a real one


class Topics(NamedTuple):
    """Names of topics of the robot."""

    scan: str = "/scan"
    odom: str = "/odom"
    cmd_vel: str = "/cmd_vel"

    def checked(self) -> Topics:
        """With absolute names; InputError for one that is not allowed."""
        return Topics(*(checked_topic(name, getattr(self, name)) for name in self._fields))


class Session:
    """A network joined to listen to one robot, and to drive it if told so."""

    def __init__(self, network: Network, topics: Topics, config: Config, say: Callable[[str], object]) -> None:
        """Join the network and subscribe; `say` prints a line. `configure` and `run` follow."""
        self._topics, self._say = topics, say
        self.config = config
        """after `configure` with the robot's laser"""
        self.notices = Notices(say)
        self._reader, self._frames = MessageReader(), TransformTree()
        self._node = Node(network)
        self._starts = self._node.reader(Topic("/initialpose", POSE, RELIABLE))
        self._scans = self._node.reader(Topic(topics.scan, LASER_SCAN, SENSOR))
        self._odometry = self._node.reader(Topic(topics.odom, ODOMETRY, SENSOR))
        self._statics = self._node.reader(Topic("/tf_static", TRANSFORMS, LATCHED._replace(depth=100)))
        self._commands: str | None = None  # their type

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.close()

    def configure(self, drive: bool) -> None:
        """Wait for scans and odometry, and complete the configuration by what they say of laser and rate.

        Mount and maximum range take precedence over the robot's messages where `config.laser` states them. A robot that
        is to be driven must subscribe to its commands. InputError if another robot sends on these topics, or reads the
        commands, and if a robot is to be driven though other machines may send to the loopback.
        """
        if leak := self._node.leak:
            if drive:
                raise InputError("interface", leak, "the interface of the robot's network")
            self._say(f"interface: {leak}")
        laser, robot, topics = self.config.laser, self.config.robot, self._topics
        stated = laser.model_fields_set
        mount = Pose(*laser.mount) if "mount" in stated or any(laser.mount) else None
        self._laser = LaserReader(self._reader, laser.max_range if "max_range" in stated else None, mount)
        self._say(f"waiting for {topics.scan} and {topics.odom}{f', to drive by {topics.cmd_vel}' * drive} ...")
        stamps, self._robot, last = self._first_messages(drive)
        if mount is None:
            self._laser.T_robot_laser, self._laser.upside_down = self._mount()
        self._laser.upside_down ^= laser.mirrored
        mount = self._laser.T_robot_laser or Pose()
        laser = described_laser([last], laser).replaced(mount=(mount.x, mount.y, mount.theta))
        if drive:
            robot = robot.replaced(control_period_s=max(robot.control_period_s, _RESPONSE_S))
            ticks = math.ceil(1e-9 * float(np.median(np.diff(stamps))) / robot.control_period_s - 0.1)
            laser = laser.replaced(period_ticks=max(1, ticks))
        self.config = self.config.replaced(laser=laser, robot=robot)

    def run(self, drive: bool, hook: OnTick, prior: PriorStart | None = None) -> Trace:
        """Run the loop until the task is over, or until the command is ended; the robot is then stopped.

        `hook` is called after each tick.
        """
        config, placed = self.config, None if prior is None else prior.pose
        radius_m = config.robot.radius or DEFAULT_ROBOT_RADIUS_M
        guard, trace = Guard(config, radius_m), Trace(config, None, radius_m, name="live")
        robot: LiveRobot
        with contextlib.ExitStack() as stack:
            pilot, steering = Pilot(Navigator(timeout_outcome="time is up"), guard), None
            if drive:
                pilot = ahead = AheadPilot(_navigator(config, placed or self._robot.T_odom_robot, radius_m), guard)
                kind = self._commands or TWIST
                writer = self._node.writer(Topic(self._topics.cmd_vel, kind, RELIABLE))
                now_ns = (lambda: robot.joiner.now(time.monotonic_ns())) if kind == TWIST_STAMPED else None
                send = stack.enter_context(Commands(writer.send, now_ns, self._robot.robot)).send
                steering = Steering(ahead, send, lambda: writer.readers)
            map_thread = stack.enter_context(ThreadPoolExecutor(1))
            for reader in (self._odometry, self._scans):  # what has arrived while the hot loops were compiled
                reader.take()
            start = None if drive or placed is not None else self._start()
            robot = LiveRobot(self._received, self.notices, config, steering, start)
            hooks = combined_hooks(
                publisher(self._node.writer, robot),
                MapSender(self._node.writer(MAP).send, map_thread.submit),
                diagnostics(self._node.writer(VERDICT).send, pilot),
                first_look(self._say),
                self._refuse_start,
                hook,
            )
            if (first := robot.begin(config.max_time or math.inf)) is None:
                if robot.outcome is not None:
                    raise InputError(self._topics.scan, f"found {robot.outcome}", "one robot")
                if not is_command_ended():
                    raise InputError(self._topics.scan, "found no scan with odometry after it", "stamps of one clock")
                raise KeyboardInterrupt
            recorded_drive(robot, first, pilot, trace, hooks, prior)
        by_user = ENDED_BY_USER if trace.outcome == "interrupted" and is_ended_by_ctrl_c() else trace.outcome
        trace.outcome = robot.outcome or by_user
        if drive and trace.outcome == "goal unreachable":
            self._say(_where(config, trace))
        return trace

    def _start(self) -> Pose | None:
        """The newest pose that was set on /initialpose, where the map begins."""
        start = None
        for _, start in self._read(self._starts, self._reader.pose_in_map):
            x, y, theta = start.array()
            self._say(f"the map begins at {x:.2f} m, {y:.2f} m, {np.degrees(theta):.0f}°")
        return start

    def _refuse_start(self, tick: Tick, trace: Trace) -> None:
        """A hook that names a pose which is set too late."""
        if self._starts.take():
            text = "a pose is left out: before the first scan of a run that does not drive it is used"
            self.notices.event("pose refused", text, time.monotonic_ns())

    def _read(self, reader: Reader, read: Callable[[bytes], Any]) -> Iterator[tuple[str, Any]]:
        """Who has sent the messages that have arrived, and what they hold; those that cannot be used are dropped."""
        for message in reader.messages():
            try:
                found = read(message.data)
            except ValueError as error:
                self.notices.drop(f"{reader.topic.name} unusable", str(error))
            else:
                yield message.publisher, found

    def _received(self, timeout_s: float) -> Iterator[Received]:
        """What has arrived, or arrives within a time; odometry first, which scans wait for."""
        self._node.wait(timeout_s)
        yield from self._read(self._odometry, self._reader.odometry)
        yield from self._read(self._scans, self._laser.scan)

    def _read_frames(self) -> None:
        for _ in self._read(self._statics, lambda data: self._reader.add_transforms(data, self._frames)):
            pass

    def _first_messages(self, drive: bool) -> tuple[list[int], RobotPose, Scan]:
        """The stamps of the latest scans, ns, the first odometry, and the latest scan; InputError for another robot."""
        stamps: list[int] = []
        odometry: RobotPose | None = None
        last, hint_s = None, time.monotonic() + _HINT_S
        while (drive and not self._commands) or len(stamps) <= _PERIODS or odometry is None or last is None:
            if is_command_ended():
                raise KeyboardInterrupt
            for topic in (self._topics.scan, self._topics.odom):
                check_one_publisher(self._node, topic)
            self._commands = command_type(self._node, self._topics.cmd_vel) if drive else None
            if time.monotonic() > hint_s:
                hint_s = math.inf
                self._say_missing(not stamps, odometry is None, drive and not self._commands)
            for _, found in self._received(_WAIT_S):
                if isinstance(found, RobotPose):
                    odometry = odometry or found
                else:
                    stamp_ns, last = found
                    stamps = sorted({*stamps, stamp_ns})[-_PERIODS - 1 :]
            self._read_frames()
        return stamps, odometry, last

    def _say_missing(self, scans: bool, odometry: bool, commands: bool) -> None:
        """Name what does not come, what does, and where else to look."""
        topics = self._topics
        missing = [f"nothing on {topics.scan}"] * scans + [f"nothing on {topics.odom}"] * odometry
        missing += [f"nobody who reads {topics.cmd_vel}"] * commands
        others = {e.topic: e.type.rpartition("/")[2] for e in self._node.publishers()}
        seen = ", ".join(f"{name} ({kind})" for name, kind in others.items()) or "none"
        networks = "other networks: `interface`, `domain`"
        self._say(f"{' and '.join(missing)} yet (seen: {seen}); {networks}")

    def _mount(self) -> tuple[Pose, bool]:
        """The mount of the laser on the robot by static transforms, and whether it is upside down."""
        until_s = time.monotonic() + (_SENT_S if self._node.publishers("/tf_static") else _FRAMES_S)
        laser, found = self._laser.frame, None
        while found is None and time.monotonic() < until_s:
            self._node.wait(_WAIT_S)
            self._read_frames()
            try:
                robot = self._robot.robot or self._frames.root(laser)
                is_told = self._robot.robot or laser in self._frames.frames()
                found = self._frames.mount(robot, laser) if is_told else None
            except ValueError as error:
                raise InputError("/tf_static", f"{error}, or `laser.mount` X Y THETA") from None
        if found is None:
            there = ", ".join(map(shown_name, self._frames.frames()[:_SHOWN])) or "none"
            missing = f"no static transforms lead from {shown_name(robot)} to {shown_name(laser)} (frames: {there})"
            self._say(f"assumed: the laser at the robot's centre, since {missing}; or `laser.mount` X Y THETA")
        return found or (Pose(), False)


def check_one_publisher(node: Node, topic: str) -> None:
    """Raise InputError if a topic has several publishers: a map of two robots is of neither."""
    if (count := len(node.publishers(topic))) > 1:
        allowed = "one robot; `scan` and `odom` name its topics, `domain` its network"
        raise InputError(topic, f"found {count} publishers", allowed)


def command_type(node: Node, topic: str) -> str | None:
    """The type of the commands that a robot takes, by its subscription; None before there is one.

    Raises InputError for several subscribers, since each may be a robot, and for one of another type.
    """
    found = [endpoint.type for endpoint in node.subscribers(topic)]
    if len(found) > 1:
        raise InputError(topic, f"found {len(found)} subscribers", "one, as each may be a robot that drives")
    if found and found[0] not in (TWIST, TWIST_STAMPED):
        raise InputError(topic, f"found a subscriber of {shown(found[0])}", f"{TWIST} or {TWIST_STAMPED}")
    return found[0] if found else None


def check_drive(config: Config) -> None:
    """Raise InputError for a task without what it needs: there is no scene to take it from."""
    needed = {"explore": ("region", "x0 y0 x1 y1"), "goal": ("goal", "x y"), "tour": ("tour", "x y x y ...")}
    name, form = needed[config.task]
    if getattr(config, name) is None:
        raise InputError(name, "missing", f"{form}, metres, in the frame of the map")


def _where(config: Config, trace: Trace) -> str:
    """Where goal and robot are, of a run whose goal cannot be reached."""
    (gx, gy), (x, y, _), grid = config.goal or (0.0, 0.0), trace.estimates[-1], trace.draw_map()
    assert grid is not None
    col, row = np.floor((np.array([gx, gy]) - grid.origin) / config.grid.cell_m).astype(int)
    is_seen = 0 <= row < grid.seen.shape[0] and 0 <= col < grid.seen.shape[1] and grid.seen[row, col]
    where = "" if is_seen else ", outside of all that was seen"
    return f"the goal is at {gx:.2f} {gy:.2f}, frame map{where}; the robot is at {x:.2f} {y:.2f}"


def _navigator(config: Config, start: Pose, radius_m: float) -> Navigator:
    check_drive(config)
    streams = random_streams(config.seed)
    goals = np.array(config.tour if config.task == "tour" else [config.goal or (0.0, 0.0)], dtype=np.float64)
    region = config.region or (start.x, start.y, start.x, start.y)
    return make_navigator(config, start, goals, region, radius_m, streams.planner, streams.exploration)
