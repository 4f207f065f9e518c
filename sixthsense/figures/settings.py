"""What a setting of the extraction costs and gains: a scan's features against those under the usual settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.figures.plot import LANDMARK, PLAN, SIGHTING, WALL_FOUND, draw_segments, label_plane
from sixthsense.slam.features import Features
from sixthsense.sources.scene import Scene

SAME_POINT_M = 0.15
"""Two sightings this near each other are of one landmark."""
SAME_WALL_M = 0.1
"""A wall whose middle and quarters lie this near walls of the other set is found by both."""


@dataclass(frozen=True, slots=True)
class Change:
    """What two extractions of one scan have in common, and what only one of them found; robot's frame, metres."""

    kept: Array
    """(K, 2) landmarks that both found, where the new one has them"""
    lost: Array
    """(L, 2) landmarks of the usual settings alone"""
    gained: Array
    """(G, 2) landmarks of the new settings alone"""
    walls_kept: Array
    """(W, 2, 2) walls of the new settings that the usual ones have, too"""
    walls_lost: Array
    """(W, 2, 2) walls of the usual settings alone"""
    walls_gained: Array
    """(W, 2, 2) walls of the new settings alone"""

    def __str__(self) -> str:
        return (
            f"landmarks: {len(self.lost)} lost, {len(self.gained)} gained; "
            f"walls: {len(self.walls_lost)} lost, {len(self.walls_gained)} gained"
        )


def compare_features(features: Features, usual: Features) -> Change:
    """Compare what a scan shows with what it `usual`ly shows: points within 0.15 m, walls within 0.1 m are the same."""
    new, old = (
        np.array([s.z for s in one.sightings if not s.is_wall], dtype=np.float64).reshape(-1, 2)
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
    """(W,) which walls (W, 2, 2) lie upon `others` (V, 2, 2)."""
    if len(others) == 0:
        return np.zeros(len(walls), dtype=np.bool_)
    shares = np.array([0.25, 0.5, 0.75])
    along = walls[:, None, 0] + shares[None, :, None] * (walls[:, None, 1] - walls[:, None, 0])  # (W, 3, 2)
    off = np.array([[point_segment_distance(p, others).min() for p in wall] for wall in along]).reshape(-1, 3)
    return (off <= SAME_WALL_M).all(axis=1)


def strays_m(pose: Pose, features: Features, scene: Scene) -> float:
    """How far a wall detected from the true `pose` strays from all true walls of the scene at most, metres."""
    along = np.linspace(0.0, 1.0, 21)[:, None]
    points = [a + along * (b - a) for a, b in pose @ features.walls]
    return max((float(point_segment_distance(p, scene.walls).min()) for part in points for p in part), default=0.0)


def draw_change(ax: Any, pose: Pose, change: Change) -> None:
    """Draw what a scan taken at `pose` shows, marking what is lost (crosses, dotted) and gained (green)."""
    draw_segments(ax, pose @ change.walls_kept, colors=WALL_FOUND, linewidths=2.0, zorder=4, label="walls detected")
    style: dict[str, Any] = {"colors": LANDMARK, "linewidths": 1.4, "linestyles": ":", "zorder": 4.5}
    draw_segments(ax, pose @ change.walls_lost, label="walls lost", **style)
    draw_segments(ax, pose @ change.walls_gained, colors=PLAN, linewidths=2.4, zorder=4, label="walls gained")
    hollow: dict[str, Any] = {"s": 50.0, "facecolors": "none", "linewidths": 1.6}
    kept, lost, gained = (pose @ points for points in (change.kept, change.lost, change.gained))
    ax.scatter(*kept.T, edgecolors=SIGHTING, zorder=5, label="landmarks detected", **hollow)
    ax.scatter(*lost.T, s=45.0, marker="x", color=LANDMARK, linewidths=1.6, zorder=6, label="landmarks lost")
    ax.scatter(*gained.T, edgecolors=PLAN, zorder=6, label="landmarks gained", **hollow)
    label_plane(ax)
