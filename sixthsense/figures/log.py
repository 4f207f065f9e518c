"""Replays of recorded logs: the way driven, and the walls of all key scans where a trajectory puts them."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.figures.plot import ESTIMATE, WALL, draw_segments, label_plane
from sixthsense.record.trace import Trace


def draw_way(ax: Any, poses: Array, color: str = ESTIMATE, label: str | None = None, width: float = 0.9) -> None:
    """Draw the way along (N, 2) positions or (N, 3) poses, world frame, metres."""
    ax.plot(poses[:, 0], poses[:, 1], color=color, linewidth=width, label=label)
    label_plane(ax)


def draw_walls_at(ax: Any, trace: Trace, poses: Array, color: str = WALL) -> None:
    """Draw the walls that the key scans showed as if these had been taken at `poses` (S, 3), one for each scan."""
    # A scan's last key scan is itself where it is one.
    first = np.unique(trace.last_key, return_index=True)[1]
    placed = [Pose.from_array(poses[s]) @ walls for s, walls in zip(first, trace.walls_found, strict=True)]
    style: dict[str, Any] = {"colors": color, "linewidths": 0.5, "alpha": 0.5, "zorder": 1}
    draw_segments(ax, np.concatenate([np.zeros((0, 2, 2)), *placed]), **style)
    label_plane(ax)
