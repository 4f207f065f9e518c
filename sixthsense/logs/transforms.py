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
from sixthsense.logs.ros_messages import frame_name, mount, planar_of, stamp_ns, transform

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
                T_parent_child, own_ns = transform(one.transform), stamp_ns(one) or record_ns
            except ValueError as error:
                refused.append(error)
                continue
            if topic.endswith("tf_static"):
                self.add_static(parent, child, T_parent_child)
            elif (link := self.add(parent, child, T_parent_child)) is not None:
                link.stamped.append((own_ns, record_ns, T_parent_child))
        return refused

    def add(self, parent: str, child: str, T_parent_child: Array) -> Link | None:
        """Add a transform of /tf to its link, which moves if it differs from the first; None for a second parent."""
        link = self.links.setdefault(child, Link(parent, T_parent_child))
        if link.parent != parent:
            if self._named not in (FramePair(parent, child), FramePair(link.parent, child)):
                self.others.add(FramePair(parent, child))
            if FramePair(parent, child) != self._named:
                return None
            link = self.links[child] = Link(parent, T_parent_child)
        link.moves |= bool(np.abs(link.first - T_parent_child).max() > _STILL)
        return link

    def add_static(self, parent: str, child: str, T_parent_child: Array) -> None:
        """Add a static transform, in place of an earlier one of that child."""
        self.links[child] = Link(parent, T_parent_child)

    def root(self, frame: str) -> str:
        """The last frame on the way from a frame to its root that is fixed to it."""
        return [*self._still(frame)][-1]

    def mount(self, robot: str, laser: str) -> tuple[Pose, bool] | None:
        """`T_robot_laser`, and whether the laser is upside down; None if no constant transforms connect them.

        They may lead either way: some robots send the laser as the parent. Raises ValueError for a laser that is not
        level.
        """
        T_up = [self._still(frame) for frame in (robot, laser)]
        shared = next((frame for frame in T_up[0] if frame in T_up[1]), None)
        return None if shared is None else mount(np.linalg.inv(T_up[0][shared]) @ T_up[1][shared])

    def frames(self) -> list[str]:
        """The names of all frames."""
        return sorted({*self.links, *(link.parent for link in self.links.values())})

    def odometry(self, laser: str, named: FramePair | None) -> tuple[FramePair, list[tuple[int, int, Pose]]]:
        """The frames of odometry, named or those of the one chain that there is; and stamps and `T_parent_child`.

        Not named, it is the first transform that moves on the way from the laser to its root, or the only one that
        moves at all. Raises ValueError for a pair that no way connects, or that is not the only one.
        """
        named = named or self._only(laser)
        chain = [self.links[pair.child] for pair in self.chain(named)]
        moving = [k for k, link in enumerate(chain) if link.moves] or [
            k for k, link in enumerate(chain) if link.stamped
        ]
        if len(moving) != 1:
            raise ValueError(f"found {named} with {len(moving)} transforms of /tf, allowed: one")
        parts = chain[: moving[0]], chain[moving[0] + 1 :]
        before, after = (reduce(np.matmul, [link.first for link in part], np.eye(4)) for part in parts)
        return named, [(own, record, planar_of(before @ T @ after)) for own, record, T in chain[moving[0]].stamped]

    def chain(self, pair: FramePair) -> list[FramePair]:
        """The links from the parent of a pair to its child; ValueError where there is no way."""
        chain: list[FramePair] = []
        for frame, link in self._up(pair.child):
            chain.insert(0, FramePair(link.parent, frame))
            if link.parent == pair.parent:
                return chain
        known = ", ".join(map(str, [*self._moving(), *sorted(self.others)][:8])) or "no transform"
        raise ValueError(f"found no way from {pair}, but {known}, allowed: frames of /tf")

    def _only(self, laser: str) -> FramePair:
        """The pair of odometry where there is one chain: that of the laser, or the only one."""
        up = [(FramePair(link.parent, frame), link) for frame, link in self._up(laser)]
        found = [pair for pair, link in up if link.moves][:1] or self._moving()
        found = found or [pair for pair, link in up if link.stamped]
        if len(found) != 1 or any(pair.child == found[0].child for pair in self.others):
            names = ", ".join(map(str, [*found, *sorted(self.others)])) or "no transform"
            raise ValueError(f"found {names}, of which none is odometry for sure, allowed: one named by {OPTION}")
        return found[0]

    def _moving(self) -> list[FramePair]:
        return sorted(FramePair(link.parent, child) for child, link in self.links.items() if link.moves)

    def _up(self, frame: str) -> Iterator[tuple[str, Link]]:
        """A frame, its parents, and the links from them, up to the root; ValueError for frames in a circle."""
        for _ in range(len(self.links) + 1):
            if frame not in self.links:
                return
            yield frame, self.links[frame]
            frame = self.links[frame].parent
        raise ValueError(f"found frames in a circle at {frame!r}, allowed: a tree")

    def _still(self, frame: str) -> dict[str, Array]:
        """(4, 4) T_parent_frame of a frame and all that it is fixed to, by name."""
        T, found = np.eye(4), {frame: np.eye(4)}
        for _, link in self._up(frame):
            if link.moves:
                break
            T = link.first @ T
            found[link.parent] = T
        return found
