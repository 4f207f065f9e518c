"""What a live run tells the network: pose and frame of odometry at every scan, and commands to the robot.

Commands have a dead man's switch: without a new one in time the robot is told to stop.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry, propagated
from sixthsense.core.source import Command, Tick
from sixthsense.live.network import Writer
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.live.robot import LiveRobot
from sixthsense.live.topics import RELIABLE, Topic
from sixthsense.loop.run import OnTick
from sixthsense.record.messages import WORLD, Messages
from sixthsense.record.trace import Trace

TIMEOUT_S = 0.3
"""A moving robot is stopped if no command has followed for this long."""

_CHECK_S = 0.05
_FAREWELLS, _BETWEEN_S = 3, 0.02

POSE = Topic("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", RELIABLE)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", RELIABLE._replace(depth=100))


def publisher(
    advertise: Callable[[Topic], Writer], robot: LiveRobot, offer_map: Callable[[int, Trace], object], ahead_s: float
) -> OnTick:
    """A hook that sends the pose after each scan and the transform of the map, with the stamp of the scan.

    `advertise` gives what a topic is written with. `offer_map` takes the stamp of each scan, after which the map may
    have changed, and the trace. The transform is dated `ahead_s` later than its scan: so long it holds for those who
    look it up.
    """
    make, pose_writer, tf_writer = Messages(), advertise(POSE), advertise(TF)

    def hook(tick: Tick, trace: Trace) -> None:
        stamp_ns = tick.stamp_ns
        if tick.scan is not None:
            pose = Pose.from_array(trace.estimates[-1])
            pose_writer.send(make.serialized(make.estimate(stamp_ns, pose, pose_covariance(trace)), POSE.type))
            T_map_odom = robot.odom_in_map(tick, pose)
            transform = make.transform(stamp_ns + round(1e9 * ahead_s), WORLD, robot.odom_frame, T_map_odom)
            tf_writer.send(make.serialized(transform, TF.type))
            offer_map(stamp_ns, trace)

    return hook


def pose_covariance(trace: Trace) -> Array:
    """(3, 3) of the pose at the last scan, world frame: that at the last keyframe, and of the motion since."""
    if not trace.key_estimates:
        return np.zeros((3, 3))
    key, since = trace.key_estimates[-1], Pose.from_array(trace.since_key[-1])
    since_cov = np.zeros((3, 3)) if trace.live is None else trace.live.since_cov
    return propagated(key.pose, key.pose_cov, Odometry(since, since_cov))


class Stamped(NamedTuple):
    """The header of commands that have one."""

    now_ns: Callable[[], int]
    """the robot's clock"""
    frame: str
    """of the robot"""


class Commands:
    """Sends commands; a thread of its own stops the robot if the loop stalls. A context manager that stops it, too."""

    def __init__(self, send: Callable[[bytes], object], stamped: Stamped | None = None) -> None:
        """`send` takes serialized messages: of type TwistStamped if they are to be stamped, else Twist."""
        self.stalls = 0
        """how often the loop was too late"""
        self._send, self._stamped, self._messages = send, stamped, Messages()
        self._lock = threading.Lock()
        self._is_moving = False
        self._sent_s = time.monotonic()
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._stop_if_late, name="dead man's switch", daemon=True)

    def __enter__(self) -> Self:
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the robot: the last thing that it hears is a standstill."""
        self._over.set()
        for _again in range(_FAREWELLS):
            self.send(Command())
            time.sleep(_BETWEEN_S)
        self._watch.join()

    def send(self, command: Command) -> None:
        """Send a command now."""
        data = self._serialized(command)
        with self._lock:
            self._send(data)
            self._is_moving = command != Command()
            self._sent_s = time.monotonic()

    def _serialized(self, command: Command) -> bytes:
        make, velocities = self._messages, (command.speed, command.turn_rate)
        if self._stamped is None:
            return make.serialized(make.twist(*velocities), TWIST)
        message = make.twist_stamped(self._stamped.now_ns(), self._stamped.frame, *velocities)
        return make.serialized(message, TWIST_STAMPED)

    def _stop_if_late(self) -> None:
        while not self._over.wait(_CHECK_S):
            if self._is_moving and time.monotonic() - self._sent_s > TIMEOUT_S:
                self.stalls += 1
                self.send(Command())
