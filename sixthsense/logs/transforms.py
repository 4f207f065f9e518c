"""The tree of frames of a robot: mount of the laser, and odometry from /tf."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose
from sixthsense.logs.refused import Refused
from sixthsense.logs.ros_messages import checked_stamp, frame_name, mount, planar_of, stamp_ns, transform

TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
OPTION = "`odometry_frames` PARENT,CHILD"
_STILL = 1e-6  # m, and entries of a rotation, by which a transform of /tf differs that does not move


class FramePair(NamedTuple):
    """Two frames, such as odom and base_link."""

    parent: str
    child: str

    def __str__(self) -> str:
        return f"{shown_name(self.parent)} -> {shown_name(self.child)}"


def frame_pair(names: Sequence[str]) -> FramePair | None:
    """The frames of odometry as an option has them, parent and child; None without names, InputError unless two."""
    if not names:
        return None
    frames = [frame_name(name.strip()) for name in names]
    if len(frames) != 2 or not all(frames) or frames[0] == frames[1]:
        raise InputError("odometry_frames", f"found {','.join(names)!r}", "PARENT,CHILD, such as odom,base_link")
    return FramePair(*frames)


@dataclass(slots=True)
class Link:
    """The transforms from a frame to one of its parents."""

    first: Array
    """(4, 4) T_parent_frame"""
    moves: bool = False
    """whether it ever changes"""
    rows: list[int] = field(default_factory=list)
    """of those with stamps, in the order of the records; none of a static transform"""


class TransformTree:
    """The transforms between frames: static ones, and those of /tf with their stamps."""

    def __init__(self) -> None:
        self.links: dict[str, dict[str, Link]] = {}
        """by frame, and by its parent; a frame has one static parent"""
        self.stamped: list[tuple[int, Array]] = []
        """stamp, ns, and (4, 4) T_parent_child of all transforms of /tf"""
        self._odometry: FramePair | None = None  # whose link is not constant, even if it never changes

    def take(self, where: str, topic: str, message: Any, record_ns: int, refused: Refused | None = None) -> list[int]:
        """Add the transforms of a message; the rows of those of /tf.

        A transform that cannot be used is counted in `refused`; without that it is an InputError about `where`.
        """
        rows = []
        for one in message.transforms:
            parent, child = frame_name(one.header.frame_id), frame_name(one.child_frame_id)
            try:
                T_parent_child = transform(one.transform)
                own = checked_stamp(where, stamp_ns(one) or record_ns)
            except ValueError as error:
                if refused is None:
                    raise InputError(f"{where} {topic}", str(error)) from None
                refused.add(topic, error)
                continue
            if topic.endswith("tf_static"):
                self.add_static(parent, child, T_parent_child)
                continue
            link = self.add(parent, child, T_parent_child)
            rows.append(len(self.stamped))
            link.rows.append(rows[-1])
            self.stamped.append((own, T_parent_child))
        return rows

    def add(self, parent: str, child: str, T_parent_child: Array) -> Link:
        """Add a transform of /tf to the link between two frames, which moves if it differs from the first one."""
        link = self.links.setdefault(child, {}).setdefault(parent, Link(T_parent_child))
        link.moves |= bool(np.abs(link.first - T_parent_child).max() > _STILL)
        return link

    def add_still(self, other: TransformTree, odometry: str) -> None:
        """Add the links of another tree that do not move, but for those of the frame of odometry: a robot may stand."""
        for child, parents in other.links.items():
            for parent, link in parents.items():
                if not link.moves and odometry not in (parent, child) and child not in self.links:
                    self.add_static(parent, child, link.first)

    def add_static(self, parent: str, child: str, T_parent_child: Array) -> None:
        """Add a static transform, in place of an earlier one of that child."""
        stamped = {name: link for name, link in self.links.get(child, {}).items() if link.rows}
        self.links[child] = {parent: Link(T_parent_child), **stamped}

    def root(self, frame: str) -> str:
        """The root of a frame's chain of constant transforms; ValueError for transforms in a circle."""
        for _ in range(len(self.links) + 1):
            parents = self.links.get(frame, {}).items()
            constant = [name for name, link in parents if not link.moves and (name, frame) != self._odometry]
            if not constant:
                return frame
            frame = constant[0]
        raise ValueError(f"found frames in a circle at {frame!r}, allowed: a tree")

    def mount(self, robot: str, laser: str) -> tuple[Pose, bool] | None:
        """`T_robot_laser`, and whether the laser is upside down; None if no constant transforms connect them.

        They may lead either way: some robots send the laser as the parent. Raises ValueError for a laser that is not
        level.
        """
        T_robot_frame, waiting = {robot: np.eye(4)}, deque([robot])
        while waiting and laser not in T_robot_frame:
            frame = waiting.popleft()
            for other, T_frame_other in self._beside(frame):
                if other not in T_robot_frame:
                    T_robot_frame[other] = T_robot_frame[frame] @ T_frame_other
                    waiting.append(other)
        return mount(T_robot_frame[laser]) if laser in T_robot_frame else None

    def frames(self) -> list[str]:
        """The names of all frames."""
        return sorted({*self.links, *(parent for of in self.links.values() for parent in of)})

    def odometry(self, laser: str, named: FramePair | None) -> tuple[FramePair, dict[int, Pose]]:
        """The frames of odometry, named or found, and by row of its transforms `T_parent_child`.

        It is found as the first transform that changes on the way from the laser to the root; without one, as the only
        one that changes away from what the laser is fixed to, sent from the robot to the frame of odometry; or else as
        the only one that changes and whose child nothing moves in. All others that never change count as constant:
        drivers of ROS 1 send the mount so. Raises ValueError where there is no such pair, several, or a frame with two
        parents.
        """
        pair, is_inverted = (named, self._is_inverted(named)) if named else self._found(laser)
        sent = FramePair(pair.child, pair.parent) if is_inverted else pair
        chain = self.chain(sent) if named else [sent]
        stamped = [at for at, link in enumerate(chain) if self._link(link).rows]
        moving = [at for at in stamped if self._link(chain[at]).moves] or stamped
        if len(moving) != 1:
            inside = ", ".join(str(chain[at]) for at in moving) or "none"
            raise ValueError(f"found {pair} with {len(moving)} transforms of /tf ({inside}), allowed: one")
        at = moving[0]
        before, after = (self._product(part) for part in (chain[:at], chain[at + 1 :]))
        self._odometry = chain[at]
        found = {row: planar_of(before @ self.stamped[row][1] @ after) for row in self._link(chain[at]).rows}
        return pair, {row: pose.inverse() for row, pose in found.items()} if is_inverted else found

    def chain(self, pair: FramePair) -> list[FramePair]:
        """The links from the parent of a pair to its child; ValueError where there is no way or several."""
        chain: list[FramePair] = []
        frame = pair.child
        while frame != pair.parent:
            parent = self._parent(frame, pair.parent)
            if parent is None or len(chain) > len(self.links):
                found = ", ".join(map(str, self._pairs()[:8])) or "no transform"
                raise ValueError(f"found no way from {pair}, but {found}, allowed: frames of /tf")
            chain.insert(0, FramePair(parent, frame))
            frame = parent
        return chain

    def transforms(self, pair: FramePair) -> list[tuple[int, Array]]:
        """Stamps, ns, and (4, 4) T_parent_child of a link, in the order of the records; one of a static one."""
        link = self._link(pair)
        return [self.stamped[row] for row in link.rows] or [(0, link.first)]

    def _is_inverted(self, pair: FramePair) -> bool:
        """Whether transforms lead from the child of a pair to its parent, and none the other way."""
        try:
            self.chain(pair)
        except ValueError:
            try:
                return bool(self.chain(FramePair(pair.child, pair.parent)))
            except ValueError:
                return False
        return False

    def _found(self, laser: str) -> tuple[FramePair, bool]:
        """The pair of odometry that the laser's frame leads to, or the only one that could be it; whether inverted."""
        frame, still = laser, None
        for _ in range(len(self.links) + 1):
            parent = self._parent(frame)
            if parent is None:
                break
            pair = FramePair(parent, frame)
            if self._link(pair).moves:
                return pair, False
            still = still or (pair if self._link(pair).rows else None)
            frame = parent
        body = [pair for pair in self._pairs() if self._link(pair).moves and self.mount(pair.parent, laser) is not None]
        if len(body) == 1:
            return FramePair(body[0].child, body[0].parent), True
        if still is not None:
            return still, False
        moving = [pair for pair in self._pairs() if self._link(pair).moves] or self._pairs()
        leaves = [pair for pair in moving if all(pair.child != other.parent for other in moving)]
        if len(leaves) != 1:
            found = ", ".join(map(str, leaves)) or "no transform"
            raise ValueError(f"found {found}, of which none leads to the laser, allowed: one named by {OPTION}")
        return leaves[0], False

    def _pairs(self) -> list[FramePair]:
        """The pairs of frames of /tf, those that change first."""
        found = [
            (not link.moves, FramePair(p, c)) for c, of in self.links.items() for p, link in of.items() if link.rows
        ]
        return [pair for _, pair in sorted(found)]

    def _link(self, pair: FramePair) -> Link:
        return self.links[pair.child][pair.parent]

    def _parent(self, frame: str, wanted: str = "") -> str | None:
        """The parent of a frame: the wanted one, else the only one; ValueError where there are several."""
        parents = self.links.get(frame, {})
        if wanted in parents:
            return wanted
        if len(parents) > 1:
            both = " and ".join(map(shown_name, sorted(parents)))
            raise ValueError(f"found {shown_name(frame)} with the parents {both}, allowed: one, or two frames by name")
        return next(iter(parents), None)

    def _beside(self, frame: str) -> Iterator[tuple[str, Array]]:
        """The frames that a constant transform connects with one, and (4, 4) T_frame_other."""
        for child, parents in self.links.items():
            for parent, link in parents.items():
                if frame in (parent, child) and not link.moves and (parent, child) != self._odometry:
                    T_child_parent = np.asarray(np.linalg.inv(link.first), dtype=np.float64)
                    yield (child, link.first) if frame == parent else (parent, T_child_parent)

    def _product(self, chain: Sequence[FramePair]) -> Array:
        """(4, 4) of a chain of constant transforms."""
        T = np.eye(4)
        for pair in chain:
            T = T @ self._link(pair).first
        return T
