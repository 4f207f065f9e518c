"""The effect of an extraction setting: the features of a scan compared with those of the default settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.figures.plot import LANDMARK, OBSERVATION, PLAN, WALL_FOUND, draw_segments, label_plane
from sixthsense.slam.features import Features
from sixthsense.sources.scene import Scene

SAME_POINT_M = 0.15
"""Largest distance of two observations of the same landmark."""
SAME_WALL_M = 0.1
"""Largest distance of a wall's middle and quarter points from walls of the other set, for a wall in both."""


@dataclass(frozen=True, slots=True)
class Change:
    """Features in both or only one of two extractions of a scan; robot frame, metres."""

    kept: Array
    """(K, 2) landmarks in both, at the positions of the new settings"""
    lost: Array
    """(L, 2) landmarks of the default settings only"""
    gained: Array
    """(G, 2) landmarks of the new settings only"""
    walls_kept: Array
    """(W, 2, 2) walls of the new settings that are in both"""
    walls_lost: Array
    """(W, 2, 2) walls of the default settings only"""
    walls_gained: Array
    """(W, 2, 2) walls of the new settings only"""

    def __str__(self) -> str:
        return (
            f"landmarks: {len(self.lost)} lost, {len(self.gained)} gained; "
            f"walls: {len(self.walls_lost)} lost, {len(self.walls_gained)} gained"
        )


def compare_features(features: Features, usual: Features) -> Change:
    """Compare features with the `usual` ones: points within 0.15 m and walls within 0.1 m are the same."""
    new, old = (
        np.array([s.z for s in one.observations if not s.is_wall], dtype=np.float64).reshape(-1, 2)
        for one in (features, usual)
    )
    gaps = np.linalg.norm(new[:, None] - old[None], axis=2)
    is_known, is_found = (gaps <= SAME_POINT_M).any(axis=1), (gaps <= SAME_POINT_M).any(axis=0)
    known, found = _covered(features.walls, usual.walls), _covered(usual.walls, features.walls)
    return Change(
        new[is_known], old[~is_found], new[~is_known],
        features.walls[known], usual.walls[~found], features.walls[~known],
    )  # fmt: skip


def _covered(walls: Array, others: Array) -> Any:
    """(W,) whether each of `walls` (W, 2, 2) lies on `others` (V, 2, 2)."""
    if len(others) == 0:
        return np.zeros(len(walls), dtype=np.bool_)
    shares = np.array([0.25, 0.5, 0.75])
    along = walls[:, None, 0] + shares[None, :, None] * (walls[:, None, 1] - walls[:, None, 0])  # (W, 3, 2)
    off = np.array([[point_segment_distance(p, others).min() for p in wall] for wall in along]).reshape(-1, 3)
    return (off <= SAME_WALL_M).all(axis=1)


def strays_m(pose: Pose, features: Features, scene: Scene) -> float:
    """Largest distance, metres, of a detected wall from the true walls, for a scan from the true `pose`."""
    along = np.linspace(0.0, 1.0, 21)[:, None]
    points = [a + along * (b - a) for a, b in pose @ features.walls]
    return max((float(point_segment_distance(p, scene.walls).min()) for part in points for p in part), default=0.0)


def draw_change(ax: Any, pose: Pose, change: Change) -> None:
    """Draw the features of a scan at `pose`, with lost ones (crosses, dotted) and gained ones (green)."""
    draw_segments(ax, pose @ change.walls_kept, colors=WALL_FOUND, linewidths=2.0, zorder=4, label="detected walls")
    style: dict[str, Any] = {"colors": LANDMARK, "linewidths": 1.4, "linestyles": ":", "zorder": 4.5}
    draw_segments(ax, pose @ change.walls_lost, label="lost walls", **style)
    draw_segments(ax, pose @ change.walls_gained, colors=PLAN, linewidths=2.4, zorder=4, label="gained walls")
    hollow: dict[str, Any] = {"s": 50.0, "facecolors": "none", "linewidths": 1.6}
    kept, lost, gained = (pose @ points for points in (change.kept, change.lost, change.gained))
    ax.scatter(*kept.T, edgecolors=OBSERVATION, zorder=5, label="detected landmarks", **hollow)
    ax.scatter(*lost.T, s=45.0, marker="x", color=LANDMARK, linewidths=1.6, zorder=6, label="lost landmarks")
    ax.scatter(*gained.T, edgecolors=PLAN, zorder=6, label="gained landmarks", **hollow)
    label_plane(ax)
