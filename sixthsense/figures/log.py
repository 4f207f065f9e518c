"""Figures of replayed logs: the path, and the walls of all keyframes placed by a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.figures.plot import ESTIMATE, WALL, draw_segments, label_plane
from sixthsense.record.trace import Trace


def draw_way(ax: Any, poses: Array, color: str = ESTIMATE, label: str | None = None, width: float = 0.9) -> None:
    """Draw the path along positions (N, 2) or poses (N, 3), world frame, metres."""
    ax.plot(poses[:, 0], poses[:, 1], color=color, linewidth=width, label=label)
    label_plane(ax)


def draw_walls_at(ax: Any, trace: Trace, poses: Array, color: str = WALL) -> None:
    """Draw the detected walls of the keyframes, placed by `poses` (S, 3), one for each scan."""
    # The first scan with a given last keyframe is that keyframe.
    first = np.unique(trace.last_key, return_index=True)[1]
    placed = [Pose.from_array(poses[s]) @ walls for s, walls in zip(first, trace.walls_found, strict=True)]
    style: dict[str, Any] = {"colors": color, "linewidths": 0.5, "alpha": 0.5, "zorder": 1}
    draw_segments(ax, np.concatenate([np.zeros((0, 2, 2)), *placed]), **style)
    label_plane(ax)
