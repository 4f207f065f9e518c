"""From serialized messages of the network to poses and scans; ValueError, and a notice, for what cannot be used.

What comes from the network is data: its size is bounded before it is read, its numbers are checked, and its names are
compared with others and shown, but are never paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command
from sixthsense.logs.laser_geometry import FARTHEST_M
from sixthsense.logs.ros_messages import LASER_SCAN, ODOMETRY, TransformTree, frame_name, planar, scan, stamp_ns
from sixthsense.record.messages import WORLD, Messages

TRANSFORMS = "tf2_msgs/msg/TFMessage"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

_MOST_BYTES = 1 << 20  # of a message
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

    def __init__(self) -> None:
        self._store = Messages().store

    def read(self, data: bytes, name: str) -> Any:
        """The message of the type of this name, with a valid header if it has one."""
        if len(data) > _MOST_BYTES:
            raise ValueError(f"found a message of {len(data)} bytes, allowed: {_MOST_BYTES}")
        try:
            message = self._store.deserialize_cdr(data, name)
        except Exception as error:  # damaged bytes raise whatever they lead to
            raise ValueError(f"found a message that cannot be read ({type(error).__name__})") from None
        if hasattr(message, "header"):
            _check_header(message.header)
        return message

    def odometry(self, data: bytes) -> RobotPose:
        """The robot's pose by its wheels."""
        message = self.read(data, ODOMETRY)
        frames = frame_name(message.header.frame_id), frame_name(message.child_frame_id)
        return RobotPose(stamp_ns(message), planar(message.pose.pose), *frames)

    def add_transforms(self, data: bytes, tree: TransformTree) -> None:
        """Add the static transforms of a message to a tree, unless it is large already."""
        for link in self.read(data, TRANSFORMS).transforms[: _MOST_FRAMES - len(tree.links)]:
            parent, child = frame_name(link.header.frame_id), frame_name(link.child_frame_id)
            tree.add_static(parent, child, link.transform)

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
    """Reads the scans of one laser, each with its own beams: that of the first scan."""

    def __init__(self, reader: MessageReader, max_range: float | None, mount: Pose | None) -> None:
        """`max_range`, metres, and `mount`, `T_robot_laser`, are those stated, which messages do not change."""
        self._reader, self._max_range = reader, max_range
        self.T_robot_laser = mount
        """mount; None: not known yet"""
        self.upside_down = False
        self.frame = ""
        """of the scans; "" before the first one"""

    def scan(self, data: bytes) -> tuple[int, Scan]:
        """The stamp of a scan, ns, and the scan."""
        message = self._reader.read(data, LASER_SCAN)
        frame = frame_name(message.header.frame_id)
        if self._max_range is None and not 0.0 < float(message.range_max) <= FARTHEST_M:  # true for NaN
            allowed = f"allowed: up to {FARTHEST_M:g} m, or state it with `laser.max_range`"
            raise ValueError(f"found range_max {float(message.range_max)}, {allowed}")
        found = scan(message, self.T_robot_laser or Pose(), self._max_range)
        self.frame = self.frame or frame
        if frame != self.frame:
            raise ValueError(f"found a scan of {shown_name(frame)}, allowed: of {shown_name(self.frame)}")
        return stamp_ns(message), found.mirrored() if self.upside_down else found


class Notices:
    """Counts what was dropped and what happened, and says it when it happens for the first time."""

    def __init__(self, say: Callable[[str], object]) -> None:
        """`say` prints a line."""
        self._say = say
        self.counts: Counter[str] = Counter()
        """number of messages that were dropped, by what was wrong with them, and of events by kind"""
        self._said_ns: dict[str, int] = {}

    def event(self, kind: str, text: str, now_ns: int) -> None:
        """Count an event, and say it unless another of its kind has been said within ten seconds."""
        self.counts[kind] += 1
        if now_ns - self._said_ns.get(kind, -_AGAIN_NS) >= _AGAIN_NS:
            self._said_ns[kind] = now_ns
            self._say(text)

    def drop(self, kind: str, fault: str = "") -> None:
        """Count a message that is not used; one line for each kind, or for each other thing that its fault allows."""
        self.counts[kind] += 1
        key = fault.partition("allowed:")[2] or fault or kind
        if key not in self._said_ns and len(self._said_ns) < _MOST_KINDS:
            self._said_ns[key] = 0
            self._say(f"dropped: {kind}{f': {fault}' if fault else ''}")

    def summary(self) -> str:
        """The numbers of what was dropped and of what happened, "" if nothing was."""
        return ", ".join(f"{kind} {count}" for kind, count in sorted(self.counts.items()))


def _check_header(header: Any) -> None:
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or nanoseconds >= 1_000_000_000 or seconds == nanoseconds == 0:
        raise ValueError(f"found the stamp {seconds} s {nanoseconds} ns, allowed: a time after 1970")
