"""Frames of a ROS bag: the chains of static transforms, and the mount of the laser on the robot."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.sources.logs.ros_messages import mount


@dataclass(slots=True)
class Frames:
    """The frames of robot and laser, and the static transforms between frames."""

    transforms: dict[str, tuple[str, Array]] = field(default_factory=dict)
    """by frame: its parent, and (4, 4) T_parent_frame"""
    robot: str = ""
    """of the odometry"""
    laser: str = ""
    """of the first scan"""

    def mount(self) -> tuple[Pose, bool] | None:
        """The mount of the laser on the robot, and whether the laser is upside down; None if no chain connects them.

        Raises ValueError for a laser that is not level, and for transforms in a circle.
        """
        robot, T_root_robot = self._root(self.robot)
        root, T_root_laser = self._root(self.laser)
        return mount(np.linalg.inv(T_root_robot) @ T_root_laser) if robot == root else None

    def root(self, frame: str) -> str:
        """The root of a frame's chain of transforms; ValueError for transforms in a circle."""
        return self._root(frame)[0]

    def _root(self, frame: str) -> tuple[str, Array]:
        """The root of a frame's chain of transforms, and (4, 4) T_root_frame."""
        T_root_frame = np.eye(4)
        for _ in range(len(self.transforms) + 1):
            if frame not in self.transforms:
                return frame, T_root_frame
            frame, link = self.transforms[frame]
            T_root_frame = link @ T_root_frame
        raise ValueError(f"found frames in a circle at {frame!r}, allowed: a tree")


def frame_name(name: str) -> str:
    """The name of a frame without the leading slash of ROS 1."""
    return str(name).lstrip("/")
