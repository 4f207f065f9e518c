"""Odometry from the transforms of a bag: which frame pair it is, and its poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.ros_frames import Frames, frame_name
from sixthsense.sources.logs.ros_messages import planar_of

OPTION = "--odometry-frames PARENT,CHILD"


class FramePair(NamedTuple):
    """The frames of odometry, such as odom and base_link."""

    parent: str
    child: str

    def __str__(self) -> str:
        return f"{shown_name(self.parent)} -> {shown_name(self.child)}"


def frame_pair(names: Sequence[str]) -> FramePair | None:
    """The frames of odometry as an option has them, parent and child; None without names, LogError unless two."""
    if not names:
        return None
    frames = [frame_name(name.strip()) for name in names]
    if len(frames) != 2 or not all(frames) or frames[0] == frames[1]:
        raise LogError(f"--odometry-frames: found {','.join(names)!r}, allowed: PARENT,CHILD, such as odom,base_link")
    return FramePair(*frames)


@dataclass(slots=True)
class Link:
    """The transforms of /tf from a frame to one of its parents."""

    first: Array
    """(4, 4)"""
    moves: bool = False
    """whether it ever changes"""
    rows: list[int] = field(default_factory=list)
    """of the transforms, in the order of the records"""


class TransformTree:
    """The transforms of /tf, and the constant ones of /tf_static."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self.links: dict[str, dict[str, Link]] = {}
        """by frame, and by its parent"""
        self.stamped: list[tuple[int, Array]] = []
        """stamp, ns, and (4, 4) T_parent_child of all transforms of /tf"""

    def add(self, parent: str, child: str, stamp_ns: int, T_parent_child: Array) -> int:
        """Add a transform of /tf; its row."""
        link = self.links.setdefault(child, {}).setdefault(parent, Link(T_parent_child))
        link.moves |= not np.array_equal(link.first, T_parent_child)
        link.rows.append(len(self.stamped))
        self.stamped.append((stamp_ns, T_parent_child))
        return link.rows[-1]

    def odometry(self, named: FramePair | None) -> tuple[FramePair, dict[int, Pose]]:
        """The frames of odometry, named or found, and by row of its transforms `T_parent_child`.

        It is found as the first transform that changes on the way from the laser to the root; without a way, as the
        only one that changes and whose child nothing moves in. Transforms that never change are taken as static.
        Raises ValueError where there is no such pair, several, or a frame with two parents.
        """
        chain = self._found() if named is None else self._chain(named)
        pair = named or FramePair(chain[0][0], chain[0][1])
        moving = [at for at, (parent, child) in enumerate(chain) if self._is_recorded(parent, child)]
        moving = [at for at in moving if self.links[chain[at][1]][chain[at][0]].moves] or moving
        if len(moving) != 1:
            inside = ", ".join(str(FramePair(*chain[at])) for at in moving) or "none"
            raise ValueError(f"found {pair} with {len(moving)} transforms of /tf ({inside}), allowed: one")
        at = moving[0]
        before, after = (self._constant(part) for part in (chain[:at], chain[at + 1 :]))
        self._keep_constant(chain[at])
        parent, child = chain[at]
        return pair, {row: planar_of(before @ self.stamped[row][1] @ after) for row in self.links[child][parent].rows}

    def pairs(self) -> list[FramePair]:
        """The pairs of frames of /tf, those that change first."""
        found = [(not link.moves, FramePair(p, c)) for c, parents in self.links.items() for p, link in parents.items()]
        return [pair for _, pair in sorted(found)]

    def _found(self) -> list[tuple[str, str]]:
        """The pair of odometry that the laser's frame leads to, or the only one that could be it."""
        frame, still = self._frames.laser, None
        for _ in range(len(self.links) + len(self._frames.transforms) + 1):
            parent = self._parent(frame)
            if parent is None:
                break
            if self._is_recorded(parent, frame):
                if self.links[frame][parent].moves:
                    return [(parent, frame)]
                still = still or (parent, frame)
            frame = parent
        if still is not None:
            return [still]
        moving = [pair for pair in self.pairs() if self.links[pair.child][pair.parent].moves] or self.pairs()
        leaves = [pair for pair in moving if all(pair.child != other.parent for other in moving)]
        if len(leaves) != 1:
            found = ", ".join(map(str, leaves)) or "no transform"
            raise ValueError(f"found {found}, of which none leads to the laser, allowed: one named by {OPTION}")
        return [(leaves[0].parent, leaves[0].child)]

    def _chain(self, pair: FramePair) -> list[tuple[str, str]]:
        """The links from the parent of a pair to its child."""
        chain: list[tuple[str, str]] = []
        frame = pair.child
        while frame != pair.parent:
            parent = self._parent(frame, pair.parent)
            if parent is None or len(chain) > len(self.links) + len(self._frames.transforms):
                found = ", ".join(map(str, self.pairs()[:8])) or "no transform"
                raise ValueError(f"found no way from {pair}, but {found}, allowed: frames of /tf")
            chain.insert(0, (parent, frame))
            frame = parent
        return chain

    def _parent(self, frame: str, wanted: str = "") -> str | None:
        """The parent of a frame: the wanted one, else the only one; ValueError where there are several."""
        static = self._frames.transforms.get(frame)
        parents = {*self.links.get(frame, {}), *([static[0]] if static else [])}
        if wanted in parents:
            return wanted
        if len(parents) > 1:
            both = " and ".join(map(shown_name, sorted(parents)))
            raise ValueError(f"found {shown_name(frame)} with the parents {both}, allowed: one, or {OPTION}")
        return next(iter(parents), None)

    def _is_recorded(self, parent: str, child: str) -> bool:
        return parent in self.links.get(child, {})

    def _constant(self, chain: list[tuple[str, str]]) -> Array:
        """(4, 4) of a chain of constant transforms."""
        T = np.eye(4)
        for parent, child in chain:
            is_recorded = self._is_recorded(parent, child)
            T = T @ (self.links[child][parent].first if is_recorded else self._frames.transforms[child][1])
        return T

    def _keep_constant(self, odometry: tuple[str, str]) -> None:
        """Add transforms of /tf that never change to the static ones: drivers of ROS 1 send the mount so."""
        for child, parents in self.links.items():
            for parent, link in parents.items():
                if not link.moves and (parent, child) != odometry:
                    self._frames.transforms.setdefault(child, (parent, link.first))
