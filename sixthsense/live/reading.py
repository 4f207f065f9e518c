"""From serialized messages of the network to poses and scans; ValueError, and a notice, for what cannot be used.

What comes from the network is data: its size is bounded before it is read, its numbers are checked, and its names are
compared with others and shown, but are never paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.logs.laser_geometry import FARTHEST_M
from sixthsense.logs.ros_messages import (
    LASER_SCAN,
    ODOMETRY,
    frame_name,
    planar,
    scan,
    stamp_ns,
    transform,
)
from sixthsense.logs.transforms import FramePair, TransformTree
from sixthsense.record.messages import WORLD, Messages

TRANSFORMS = "tf2_msgs/msg/TFMessage"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

_MOST_BYTES = {LASER_SCAN: 1 << 20, ODOMETRY: 1 << 13, TRANSFORMS: 1 << 18, TWIST: 1 << 8, TWIST_STAMPED: 1 << 10}
_MOST_BYTES[POSE] = 1 << 11
_LONGEST_FRAME = 256  # letters of the name of a frame
_MOST_FRAMES = 1000
_MOST_KINDS = 50
_AGAIN_NS = 10_000_000_000  # from one line of an event to the next of its kind
_FASTEST = 100.0  # m/s and rad/s of a command


class RobotPose(NamedTuple):
    """A message of odometry."""

    stamp_ns: int
    T_odom_robot: Pose
    frame: str
    """of odometry"""
    robot: str
    """frame of the robot"""


class MessageReader:
    """Reads serialized messages."""

    def __init__(self, frames: FramePair | None = None) -> None:
        """`frames` are those of odometry in /tf; None: it is a topic of Odometry."""
        self._store, self._frames = Messages().store, frames

    def read(self, data: bytes, name: str) -> Any:
        """The message of the type of this name, with a valid header if it has one."""
        if len(data) > _MOST_BYTES[name]:
            raise ValueError(f"found a message of {len(data)} bytes, allowed: {_MOST_BYTES[name]}")
        try:
            message = self._store.deserialize_cdr(data, name)
        except Exception as error:  # damaged bytes raise whatever they lead to
            raise ValueError(f"found a message that cannot be read ({type(error).__name__})") from None
        if hasattr(message, "header"):
            _check_header(message.header)
        return message

    def has_odometry(self, data: bytes) -> bool:
        """Whether a message is one of odometry: those of /tf are of all frames. What cannot be read counts as one."""
        if self._frames is None:
            return True
        try:
            return any(self._is_odometry(link) for link in self.read(data, TRANSFORMS).transforms)
        except ValueError:
            return True

    def odometry(self, data: bytes) -> RobotPose:
        """The robot's pose by its wheels."""
        if self._frames is not None:
            links = [link for link in self.read(data, TRANSFORMS).transforms if self._is_odometry(link)]
            if not links:
                raise ValueError(f"found no transform {self._frames}, allowed: one")
            _check_header(links[-1].header)
            place = planar(links[-1].transform)
            return RobotPose(stamp_ns(links[-1]), place, *self._frames)
        message = self.read(data, ODOMETRY)
        pose = planar(message.pose.pose)
        robot = _checked_frame(message.child_frame_id)
        return RobotPose(stamp_ns(message), pose, frame_name(message.header.frame_id), robot)

    def add_transforms(self, data: bytes, tree: TransformTree, are_static: bool = True) -> None:
        """Add the transforms of a message, static or of /tf, to a tree, unless it is large already."""
        for link in self.read(data, TRANSFORMS).transforms:
            parent, child = _checked_frame(link.header.frame_id), _checked_frame(link.child_frame_id)
            if len(tree.links) < _MOST_FRAMES:
                (tree.add_static if are_static else tree.add)(parent, child, transform(link.transform))

    def _is_odometry(self, link: Any) -> bool:
        return (frame_name(link.header.frame_id), frame_name(link.child_frame_id)) == self._frames

    def command(self, data: bytes, name: str = TWIST) -> Command:
        """The command of a Twist, or of a TwistStamped if that is the type of this name."""
        message = self.read(data, name)
        message = message.twist if name == TWIST_STAMPED else message
        speed, turn_rate = float(message.linear.x), float(message.angular.z)
        if not (abs(speed) <= _FASTEST and abs(turn_rate) <= _FASTEST):  # false for NaN
            raise ValueError(f"found a command of {speed} m/s and {turn_rate} rad/s, allowed: up to {_FASTEST:g}")
        return Command(speed, turn_rate)

    def pose_in_map(self, data: bytes) -> Pose:
        """The pose of a PoseWithCovarianceStamped in the frame of the map."""
        message = self.read(data, POSE)
        if (frame := frame_name(message.header.frame_id)) != WORLD:
            raise ValueError(f"found a pose in the frame {shown_name(frame)}, allowed: in {WORLD}")
        return planar(message.pose.pose)


class LaserReader:
    """Reads the scans of one laser, each with its own beams: that whose frame most scans have until it is `fixed`."""

    def __init__(self, reader: MessageReader, max_range: float | None, mount: Pose | None) -> None:
        """`max_range`, metres, and `mount`, `T_robot_laser`, are those stated, which messages do not change."""
        self._reader, self._max_range = reader, max_range
        self.T_robot_laser = mount
        """mount; None: not known yet"""
        self.upside_down = False
        self.frame = ""
        """of the scans"""
        self._counts: Counter[str] | None = Counter()
        """number of scans by frame; None once the frame is fixed"""

    def scan(self, data: bytes) -> tuple[int, Scan]:
        """The stamp of a scan, ns, and the scan."""
        message = self._reader.read(data, LASER_SCAN)
        frame = frame_name(message.header.frame_id)
        if self._max_range is None and not 0.0 < float(message.range_max) <= FARTHEST_M:  # true for NaN
            allowed = f"allowed: up to {FARTHEST_M:g} m, or state it with `laser.max_range`"
            raise ValueError(f"found range_max {float(message.range_max)}, {allowed}")
        found = scan(message, self.T_robot_laser or Pose(), self.upside_down, self._max_range)
        if self._counts is not None:
            self._counts[frame] += 1
            if self._counts[frame] > self._counts[self.frame]:
                self.frame = frame
        if frame != self.frame:
            raise ValueError(f"found a scan of {shown_name(frame)}, allowed: of {shown_name(self.frame)}")
        return stamp_ns(message), found

    def fix(self) -> None:
        """Take scans of the present frame alone from now on."""
        self._counts = None


class Notices:
    """Counts what was dropped, and says it when it happens for the first time."""

    def __init__(self, say: Callable[[str], object]) -> None:
        """`say` prints a line."""
        self._say = say
        self.dropped: Counter[str] = Counter()
        """number of messages by what was wrong with them"""
        self.events: Counter[str] = Counter()
        """number of events by kind"""
        self._said: set[str] = set()
        self._said_ns: dict[str, int] = {}

    def event(self, kind: str, text: str, now_ns: int) -> None:
        """Count an event, and say it unless another of its kind has been said within ten seconds."""
        self.events[kind] += 1
        if now_ns - self._said_ns.get(kind, -_AGAIN_NS) >= _AGAIN_NS:
            self._said_ns[kind] = now_ns
            self._say(text)

    def unusable(self, topic: str, error: ValueError) -> None:
        """Count a message of a topic that cannot be used; one line for each that is not allowed for another reason."""
        self.dropped[f"{topic} unusable"] += 1
        text = str(error)
        kind = text.partition("allowed:")[2] or text
        if kind not in self._said and len(self._said) < _MOST_KINDS:
            self._said.add(kind)
            self._say(f"{topic}: {text}; dropped")

    def count(self, dropped: Mapping[str, int]) -> None:
        """Record the present numbers of another counter."""
        for kind, count in dropped.items():
            if kind not in self.dropped:
                self._say(f"dropped: {kind}")
            self.dropped[kind] = count

    def summary(self) -> list[str]:
        """The numbers of what was dropped and of what happened, a line each if there was any."""
        both = (("dropped", self.dropped), ("events", self.events))
        return [f"{name}: {', '.join(f'{k} {n}' for k, n in sorted(c.items()))}" for name, c in both if c]


def _check_header(header: Any) -> None:
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or nanoseconds >= 1_000_000_000 or seconds == nanoseconds == 0:
        raise ValueError(f"found the stamp {seconds} s {nanoseconds} ns, allowed: a time after 1970")
    _checked_frame(header.frame_id)


def _checked_frame(name: str) -> str:
    if len(name) > _LONGEST_FRAME:
        raise ValueError(f"found a name of a frame with {len(name)} letters, allowed: {_LONGEST_FRAME}")
    return frame_name(name)
