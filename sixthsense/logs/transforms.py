"""The tree of frames of a robot: mount of the laser, and odometry from /tf."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose
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
    """The transforms from a frame to its parent."""

    parent: str
    first: Array
    """(4, 4) T_parent_frame"""
    moves: bool = False
    """whether it ever changes"""
    stamped: list[tuple[int, int, Array]] = field(default_factory=list)
    """stamp of the header and time of recording, ns, and (4, 4) of those of /tf, in the order of the records"""


class TransformTree:
    """The transforms between frames: static ones, and those of /tf with their stamps."""

    def __init__(self, named: FramePair | None = None) -> None:
        """Of several parents of a frame, the one of the `named` pair is kept, else the first."""
        self.links: dict[str, Link] = {}
        """by frame"""
        self._named = named
        self.others: set[FramePair] = set()
        """links from a frame to another parent, which are not in the tree"""

    def take(self, topic: str, message: Any, record_ns: int) -> list[ValueError]:
        """Add the transforms of a message; what is wrong with those that cannot be used."""
        refused: list[ValueError] = []
        for one in message.transforms:
            parent, child = frame_name(one.header.frame_id), frame_name(one.child_frame_id)
            try:
                T_parent_child = transform(one.transform)
                own = checked_stamp("stamp", stamp_ns(one) or record_ns)
            except ValueError as error:
                refused.append(error)
                continue
            if topic.endswith("tf_static"):
                self.add_static(parent, child, T_parent_child)
            elif (link := self.add(parent, child, T_parent_child)) is not None:
                link.stamped.append((own, record_ns, T_parent_child))
        return refused

    def add(self, parent: str, child: str, T_parent_child: Array) -> Link | None:
        """Add a transform of /tf to its link, which moves if it differs from the first; None for a second parent."""
        link = self.links.setdefault(child, Link(parent, T_parent_child))
        if link.parent != parent and FramePair(parent, child) == self._named:
            link = self.links[child] = Link(parent, T_parent_child)
        elif link.parent != parent:
            if FramePair(link.parent, child) != self._named:
                self.others.add(FramePair(parent, child))
            return None
        link.moves |= bool(np.abs(link.first - T_parent_child).max() > _STILL)
        return link

    def add_static(self, parent: str, child: str, T_parent_child: Array) -> None:
        """Add a static transform, in place of an earlier one of that child."""
        self.links[child] = Link(parent, T_parent_child)

    def add_still(self, other: TransformTree, odometry: str) -> None:
        """Add the links of another tree that do not move, but for those of the frame of odometry: a robot may stand."""
        for child, link in other.links.items():
            if not link.moves and odometry not in (link.parent, child) and child not in self.links:
                self.add_static(link.parent, child, link.first)

    def root(self, frame: str, odometry: str = "") -> str:
        """The last frame on the way from a frame to its root that is fixed to it; the frame of odometry is not."""
        for parent, link in self._up(frame):
            if link.moves or odometry in (parent, frame):
                return frame
            frame = parent
        return frame

    def mount(self, robot: str, laser: str) -> tuple[Pose, bool] | None:
        """`T_robot_laser`, and whether the laser is upside down; None if no constant transforms connect them.

        They may lead either way: some robots send the laser as the parent. Raises ValueError for a laser that is not
        level.
        """
        T_up = [self._still(frame) for frame in (robot, laser)]
        shared = next((frame for frame in T_up[0] if frame in T_up[1]), None)
        if shared is None:
            return None
        return mount(np.linalg.inv(T_up[0][shared]) @ T_up[1][shared])

    def frames(self) -> list[str]:
        """The names of all frames."""
        return sorted({*self.links, *(link.parent for link in self.links.values())})

    def odometry(self, laser: str, named: FramePair | None) -> tuple[FramePair, list[tuple[int, int, Pose]]]:
        """The frames of odometry, named or those of the one chain that there is; and stamps and `T_parent_child`.

        Not named, it is the first transform that moves on the way from the laser to its root, or the only one that
        moves at all. Raises ValueError for a pair that no way connects, or that is not the only one.
        """
        if named is None:
            named = self._chain_of(laser)
        chain = self.chain(named)
        moving = [k for k, pair in enumerate(chain) if self.links[pair.child].stamped]
        moving = [k for k in moving if self.links[chain[k].child].moves] or moving
        if len(moving) != 1:
            inside = ", ".join(str(chain[k]) for k in moving) or "none"
            raise ValueError(f"found {named} with {len(moving)} transforms of /tf ({inside}), allowed: one")
        parts = chain[: moving[0]], chain[moving[0] + 1 :]
        before, after = (reduce(np.matmul, [self.links[p.child].first for p in part], np.eye(4)) for part in parts)
        stamped = self.links[chain[moving[0]].child].stamped
        return named, [(own, record, planar_of(before @ T @ after)) for own, record, T in stamped]

    def chain(self, pair: FramePair) -> list[FramePair]:
        """The links from the parent of a pair to its child; ValueError where there is no way."""
        chain: list[FramePair] = []
        frame = pair.child
        for parent, _ in self._up(pair.child):
            chain.insert(0, FramePair(parent, frame))
            frame = parent
            if parent == pair.parent:
                return chain
        known = ", ".join(map(str, [*self._moving(), *sorted(self.others)][:8])) or "no transform"
        raise ValueError(f"found no way from {pair}, but {known}, allowed: frames of /tf")

    def transforms(self, pair: FramePair) -> list[tuple[int, Array]]:
        """Stamps, ns, and (4, 4) T_parent_child of a link, in the order of the records; one of a static one."""
        link = self.links[pair.child]
        return [(own, T) for own, _, T in link.stamped] or [(0, link.first)]

    def _chain_of(self, laser: str) -> FramePair:
        """The pair of odometry where there is one chain: that of the laser, or the only one."""
        frame, still = laser, []
        for parent, link in self._up(laser):
            if link.moves and not any(pair.child == frame for pair in self.others):
                return FramePair(parent, frame)
            still += [FramePair(parent, frame)] if link.stamped else []
            frame = parent
        moving = self._moving() or still
        if len(moving) != 1 or self.others:
            names = ", ".join(map(str, [*moving, *sorted(self.others)])) or "no transform"
            raise ValueError(f"found {names}, of which none is odometry for sure, allowed: one named by {OPTION}")
        return moving[0]

    def _moving(self) -> list[FramePair]:
        return sorted(FramePair(link.parent, child) for child, link in self.links.items() if link.moves)

    def _up(self, frame: str) -> Iterator[tuple[str, Link]]:
        """The parents of a frame and the links to them, up to the root; ValueError for frames in a circle."""
        for _ in range(len(self.links) + 1):
            if frame not in self.links:
                return
            link = self.links[frame]
            yield link.parent, link
            frame = link.parent
        raise ValueError(f"found frames in a circle at {frame!r}, allowed: a tree")

    def _still(self, frame: str) -> dict[str, Array]:
        """(4, 4) T_parent_frame of a frame and all that it is fixed to, by name."""
        T, found = np.eye(4), {frame: np.eye(4)}
        for parent, link in self._up(frame):
            if link.moves:
                break
            T = link.first @ T
            found[parent] = T
        return found
