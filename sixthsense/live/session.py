"""A live run: join the network, wait for the robot, run the loop with it."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Self

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown, shown_name
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.random_streams import random_streams
from sixthsense.live.ahead_pilot import AheadPilot
from sixthsense.live.diagnostics import TOPIC as DIAGNOSTICS
from sixthsense.live.diagnostics import diagnostics
from sixthsense.live.first_look import first_look
from sixthsense.live.maps import MAP, MapSender
from sixthsense.live.network import Network, Node, Reader
from sixthsense.live.publishing import Commands, Stamped, publisher
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
from sixthsense.live.robot import LiveRobot, Received, Steering
from sixthsense.live.topics import FAST_SENSOR, LATCHED, RELIABLE, SENSOR, Topic, checked_topic
from sixthsense.logs.log import described_laser
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY
from sixthsense.logs.transforms import FramePair, TransformTree
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

_TF = "/tf"
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
    frames: FramePair | None = None
    """of odometry in /tf, instead of a topic of Odometry"""

    def checked(self) -> Topics:
        """With absolute names; InputError for one that is not allowed."""
        scan, odom, cmd_vel = (checked_topic(name, getattr(self, name)) for name in ("scan", "odom", "cmd_vel"))
        return Topics(scan, odom if self.frames is None else _TF, cmd_vel, self.frames)

    @property
    def odometry(self) -> Topic:
        """The topic of odometry."""
        return Topic(self.odom, ODOMETRY if self.frames is None else TRANSFORMS, FAST_SENSOR)


class Session:
    """A network joined to listen to one robot, and to drive it if told so."""

    def __init__(
        self,
        network: Network,
        topics: Topics,
        config: Config,
        say: Callable[[str], object],
        transform_ahead_s: float = 0.0,
    ) -> None:
        """Join the network and subscribe; `say` prints a line. `configure` and `run` follow.

        The transform of the map is dated `transform_ahead_s` later than its scan.
        """
        self._transform_ahead_s = transform_ahead_s
        self._network, self._node = network, Node(network)
        self._topics, self._say = topics, say
        self.config = config
        """after `configure` with the robot's laser"""
        self.notices = Notices(say)
        self._reader = MessageReader(topics.frames)
        self._starts = self._node.reader(Topic("/initialpose", POSE, RELIABLE))
        self._frames = TransformTree()
        self._scans = self._node.reader(Topic(topics.scan, LASER_SCAN, SENSOR))
        self._odometry = self._node.reader(topics.odometry)
        self._transforms = self._node.reader(Topic("/tf_static", TRANSFORMS, LATCHED._replace(depth=100)))
        self._commands: str | None = None  # their type
        self._open = contextlib.ExitStack()
        self._open.callback(self._node.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def configure(self, drive: bool) -> None:
        """Wait for scans and odometry, and complete the configuration by what they say of laser and rate.

        Mount and maximum range take precedence over the robot's messages where `config.laser` states them. A robot that
        is to be driven must subscribe to its commands. InputError if another robot sends on these topics, or reads the
        commands, and if a robot is to be driven though other machines may send to the loopback.
        """
        check_confined(self._network, self._node, self._say, drive)
        self._maps = self._open.enter_context(MapSender(self._node.writer(MAP), self._say))
        laser = self.config.laser
        stated = laser.explicit_fields
        mount = Pose(*laser.mount) if "mount" in stated or any(laser.mount) else None
        self._laser = LaserReader(self._reader, laser.max_range if "max_range" in stated else None, mount)
        topics = self._topics
        needed = topics.scan if self.config.no_odometry else f"{topics.scan} and {topics.odom}"
        self._say(f"waiting for {needed}{f', to drive by {topics.cmd_vel}' * drive} ...")
        scans, self._robot, found = self._first_messages(drive)
        stamps = sorted(scans)
        if mount is None:
            self._laser.T_robot_laser, self._laser.upside_down = self._mount()
        self._laser.upside_down ^= laser.mirrored
        self._laser.fix()
        _, scan = self._laser.scan(found)
        laser = described_laser([scan], laser)
        robot = self.config.robot
        if drive:
            period_s = 1e-9 * float(np.median(np.diff(stamps)))
            robot = robot.replaced(control_period_s=max(robot.control_period_s, _RESPONSE_S))
            ticks = max(1, math.ceil(period_s / robot.control_period_s - 0.1))
            laser = laser.replaced(period_ticks=ticks)
        self.config = self.config.replaced(laser=laser, robot=robot)

    def run(self, drive: bool, hook: OnTick | None = None, prior: PriorStart | None = None) -> Trace:
        """Run the loop until the task is over, or until the command is ended; the robot is then stopped."""
        config = self.config
        radius_m = config.robot.radius or DEFAULT_ROBOT_RADIUS_M
        guard = Guard(config, radius_m)
        trace = Trace(config, None, radius_m, name="live")
        with contextlib.ExitStack() as stack:
            pilot = Pilot(Navigator(timeout_outcome="time is up"), guard)
            steering = None
            if drive:
                believed = self._robot.T_odom_robot if prior is None or prior.pose is None else prior.pose
                pilot = ahead = AheadPilot(_navigator(config, believed, radius_m), guard)
                kind = self._commands or TWIST
                writer = self._node.writer(Topic(self._topics.cmd_vel, kind, RELIABLE))
                clock = Stamped(lambda: robot.joiner.clock.now(time.monotonic_ns()), self._robot.robot)
                send = stack.enter_context(Commands(writer.send, clock if kind == TWIST_STAMPED else None)).send
                steering = Steering(ahead, send, lambda: writer.readers)
            readers, start = (
                (self._reader, self._laser),
                self._start if prior is None or prior.pose is None else _no_start,
            )
            robot = LiveRobot(self._received, readers, self.notices, config, steering, start=start)
            if config.no_odometry:
                robot.odom_frame = self._frames.root(self._laser.frame)
            hooks = [
                publisher(self._node.writer, robot, self._maps.offer, self._transform_ahead_s),
                diagnostics(self._node.writer(DIAGNOSTICS).send, pilot),
                first_look(self._say, not config.no_odometry),
                *([] if hook is None else [hook]),
            ]
            self._discard()
            if (first := robot.begin()) is None:
                if robot.outcome is not None:
                    raise InputError(self._topics.scan, f"found {robot.outcome}", "one robot")
                raise KeyboardInterrupt
            recorded_drive(robot, first, pilot, trace, combined_hooks(*hooks), prior)
        trace.outcome = robot.outcome or _by_user(trace.outcome)
        if drive and trace.outcome == "goal unreachable":
            self._say(_where(config, trace))
        return trace

    def _start(self) -> Pose | None:
        """The newest pose that was set on /initialpose since the last call."""
        found = None
        for data in self._starts.take():
            try:
                found = self._reader.pose_in_map(data)
            except ValueError as error:
                self.notices.unusable("/initialpose", error)
        return found

    def _received(self, timeout_s: float) -> Iterator[Received]:
        """Messages that have arrived, or arrive within a time; odometry first, which scans wait for."""
        self._node.wait(timeout_s)
        for data in self._transforms.take():
            try:
                self._reader.add_transforms(data, self._frames)
            except ValueError as error:
                self.notices.unusable("/tf_static", error)
        for message in () if self.config.no_odometry else self._odometry.messages():
            if self._reader.has_odometry(message.data):
                yield False, message
        for message in self._scans.messages():
            yield True, message

    def _discard(self) -> None:
        """Drop what has arrived while the hot loops were compiled."""
        self._odometry.take()
        self._scans.take()

    def _first_messages(self, drive: bool) -> tuple[dict[int, Scan], RobotPose, bytes]:
        """The latest scans by their stamps, the first odometry, and a scan."""
        scans: dict[int, Scan] = {}
        odometry: RobotPose | None = RobotPose(0, Pose(), "odom", "") if self.config.no_odometry else None
        last = b""
        hint_s = time.monotonic() + _HINT_S
        while self._is_robot_missing(drive) or len(scans) <= _PERIODS or odometry is None:
            if is_command_ended():
                raise KeyboardInterrupt
            if time.monotonic() > hint_s:
                hint_s = math.inf
                topics = self._topics
                odom = topics.odom if topics.frames is None else f"{_TF} {topics.frames}"
                heard = {topics.scan: bool(scans), odom: odometry is not None}
                missing = [f"nothing on {topic}" for topic, is_heard in heard.items() if not is_heard]
                missing += [f"nobody who reads {topics.cmd_vel}"] * (drive and not self._commands)
                if odometry is None and topics.frames is None:
                    missing[-1] += " (in /tf: `odometry_frames` odom,base_link; none: `no_odometry`)"
                seen = ", ".join(f"{name} ({kind.rpartition('/')[2]})" for name, kind in self._node.seen().items())
                networks = "other networks: `interface`, `domain`, `peers`"
                self._say(f"{' and '.join(missing)} yet (seen: {seen or 'none'}); {networks}")
            for is_scan, message in self._received(_WAIT_S):
                try:
                    if is_scan:
                        stamp_ns, scan = self._laser.scan(message.data)
                        scans, last = {k: scans[k] for k in sorted(scans)[-_PERIODS:]}, message.data
                        scans[stamp_ns] = scan
                    else:
                        odometry = odometry or self._reader.odometry(message.data)
                except ValueError as error:
                    self.notices.unusable("scan" if is_scan else "odometry", error)
        return scans, odometry, last

    def _is_robot_missing(self, drive: bool) -> bool:
        """Whether nobody takes the commands of a robot that is to be driven; InputError if there is another robot."""
        is_topic = self._topics.frames is None and not self.config.no_odometry
        for reader in (self._scans, self._odometry) if is_topic else (self._scans,):
            check_one_publisher(reader)
        self._commands = command_type(self._node, self._topics.cmd_vel) if drive else None
        return drive and self._commands is None

    def _mount(self) -> tuple[Pose, bool]:
        """The mount of the laser on the robot and whether it is upside down.

        It is that of static transforms, or after some time of those of /tf that have not moved meanwhile.
        """
        began_s, moving, is_all = time.monotonic(), TransformTree(), False
        reader = self._node.reader(Topic(_TF, TRANSFORMS, FAST_SENSOR))
        while True:
            waited_s = time.monotonic() - began_s
            is_late = waited_s > (_SENT_S if self._transforms.publishers else _FRAMES_S)
            try:
                robot = self._robot.robot or self._frames.root(self._laser.frame)
                found = self._frames.mount(robot, self._laser.frame)
                if not self._robot.robot and robot == self._laser.frame and not is_late:
                    found = None  # there may be transforms yet
            except ValueError as error:
                raise InputError("/tf_static", f"{error}, or `laser.mount` X Y THETA") from None
            if found is not None:
                return found
            if is_late and is_all:
                frames = f"{shown_name(robot)} to {shown_name(self._laser.frame)}"
                there = ", ".join(map(shown_name, self._frames.frames()[:_SHOWN])) or "none"
                missing = f"no constant transforms lead from {frames} (frames: {there})"
                self._say(f"assumed: the laser at the robot's centre, since {missing}")
                return Pose(), False
            if is_late:
                self._frames.add_still(moving, self._robot.frame)
                is_all = True
                continue
            for _ in self._received(_WAIT_S):
                pass
            for data in reader.take():
                try:
                    self._reader.add_transforms(data, moving, are_static=False)
                except ValueError as error:
                    self.notices.unusable(_TF, error)


def check_confined(network: Network, node: Node, say: Callable[[str], object], drive: bool) -> None:
    """Say if other machines may send to the loopback; InputError if a robot is to be driven there."""
    if not network.is_loopback or node.is_confined:
        return
    found = "found the loopback, to which this system lets other machines send"
    if drive:
        raise InputError("interface", found, "the interface of the robot's network")
    say(f"interface: {found}")


def check_one_publisher(reader: Reader) -> None:
    """Raise InputError if a topic has several publishers: a map of two robots is of neither."""
    if (count := reader.publishers) > 1:
        found = f"found {count} publishers"
        raise InputError(reader.topic.name, found, "one robot; `scan` and `odom` name its topics, `domain` its network")


def command_type(node: Node, topic: str) -> str | None:
    """The type of the commands that a robot takes, by its subscription; None before there is one.

    `is_stamped` demands TwistStamped. Raises InputError for several subscribers, since each may be a robot, and for
    one of another type.
    """
    found = node.subscribers(topic)
    if not found:
        return None
    if len(found) > 1:
        raise InputError(topic, f"found {len(found)} subscribers", "one, as each may be a robot that drives")
    (kind, _) = found[0]
    allowed = (TWIST, TWIST_STAMPED)
    if kind in allowed:
        return kind
    raise InputError(topic, f"found a subscriber of {shown(kind)}", f"{' or '.join(allowed)}")


def check_drive(config: Config) -> None:
    """Raise InputError for a task without what it needs: there is no scene to take it from."""
    needed = {"explore": ("region", "x0 y0 x1 y1"), "goal": ("goal", "x y"), "tour": ("tour", "x y x y ...")}
    name, form = needed[config.task]
    if getattr(config, name) is None:
        raise InputError(name, "missing", f"{form}, metres, in the frame of the map")


def _no_start() -> Pose | None:
    """No pose is set where a prior map says where the run begins."""
    return None


def _where(config: Config, trace: Trace) -> str:
    """Where goal and robot are, of a run whose goal cannot be reached."""
    (gx, gy), (x, y, _) = config.goal or (0.0, 0.0), trace.estimates[-1]
    grid = trace.draw_map()
    assert grid is not None
    col, row = np.floor((np.array([gx, gy]) - grid.origin) / config.grid.cell_m).astype(int)
    seen = grid.seen
    is_seen = 0 <= row < seen.shape[0] and 0 <= col < seen.shape[1] and seen[row, col]
    where = "" if is_seen else ", outside of all that was seen"
    return f"the goal is at {gx:.2f} {gy:.2f}, frame `map`{where}; the robot is at {x:.2f} {y:.2f}"


def _by_user(outcome: str) -> str:
    """The outcome of a run that the loop calls interrupted."""
    return ENDED_BY_USER if outcome == "interrupted" and is_ended_by_ctrl_c() else outcome


def _navigator(config: Config, start: Pose, radius_m: float) -> Navigator:
    check_drive(config)
    streams = random_streams(config.seed)
    goals = np.array(config.tour if config.task == "tour" else [config.goal or (0.0, 0.0)], dtype=np.float64)
    region = config.region or (0.0, 0.0, 0.0, 0.0)
    return make_navigator(config, start, goals, region, radius_m, streams.planner, streams.exploration)
