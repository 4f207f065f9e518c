"""What one scan shows, stage by stage (report figures 2, 3, 4 and 11)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Sighting
from sixthsense.core.laser import Scan
from sixthsense.figures.plot import CYCLE, LANDMARK, SIGHTING, WALL_FOUND, draw_segments, ellipse, label_plane
from sixthsense.slam.features import Features
from sixthsense.slam.features.partition import Indices

_RETURN = "#666666"
_NORMAL_95 = 1.96  # sigmas


def _points(pose: Pose, scan: Scan) -> Array:
    """(N, 2) where the beams end, world frame; a beam that met nothing ends at NaN."""
    points = np.where(np.isfinite(scan.ranges)[:, None], scan.points_robot, np.nan)
    return pose @ points


def draw_beams(ax: Any, pose: Pose, scan: Scan, color: str = LANDMARK) -> None:
    """Draw the beams of a scan taken at `pose`; those that met nothing reach to the maximum range."""
    lengths = np.where(np.isfinite(scan.ranges), scan.ranges, scan.max_range).astype(np.float64)
    T_world_laser = pose @ scan.T_robot_laser
    bearings = scan.bearings
    ends = T_world_laser @ np.stack([lengths * np.cos(bearings), lengths * np.sin(bearings)], axis=1)
    starts = np.broadcast_to(T_world_laser.position, ends.shape)
    style = {"colors": color, "linewidths": 0.3, "alpha": 0.6, "zorder": 1}
    draw_segments(ax, np.stack([starts, ends], axis=1), label="beams", **style)
    label_plane(ax)


def draw_returns(ax: Any, pose: Pose, scan: Scan, color: str = _RETURN, size: float = 4.0) -> None:
    """Draw where the beams of a scan taken at `pose` ended."""
    points = _points(pose, scan)
    ax.scatter(points[:, 0], points[:, 1], s=size, color=color, linewidths=0.0, zorder=3, label="laser returns")
    label_plane(ax)


def draw_partitions(ax: Any, pose: Pose, scan: Scan, parts: Sequence[Indices], least: int = 1) -> None:
    """Draw each partition's returns in a colour of its own, and grey those in none; fewer than `least` are none."""
    points = _points(pose, scan)
    draw_returns(ax, pose, scan, color="#BBBBBB", size=3.0)
    for k, part in enumerate(part for part in parts if len(part) >= least):
        ax.scatter(*points[part].T, s=8.0, color=CYCLE[k % len(CYCLE)], linewidths=0.0, zorder=4)


def draw_detections(ax: Any, pose: Pose, features: Features, enlarged: float = 0.0) -> None:
    """Draw the walls (pink) and landmarks (cyan circles) that one scan from `pose` shows.

    `enlarged` draws the sightings' 95 % ellipses too, so many times as large as they are.
    """
    draw_segments(ax, pose @ features.walls, colors=WALL_FOUND, linewidths=2.0, zorder=4, label="walls detected")
    sightings = [sighting for sighting in features.sightings if not sighting.is_wall]
    if sightings:
        points = pose @ np.array([sighting.z for sighting in sightings])
        style = {"facecolors": "none", "edgecolors": SIGHTING, "linewidths": 1.6, "zorder": 5}
        ax.scatter(points[:, 0], points[:, 1], s=50.0, label="landmarks detected", **style)
        for k, sighting in enumerate(sightings if enlarged else ()):
            outline = pose @ ellipse(sighting.z, enlarged**2 * sighting.cov)
            label = f"95 %, {enlarged:g} times enlarged" if k == 0 else None
            ax.plot(outline[:, 0], outline[:, 1], color=LANDMARK, linewidth=0.8, zorder=6, label=label)
    label_plane(ax)


def draw_wall_bands(ax: Any, pose: Pose, sightings: Sequence[Sighting], enlarged: float = 1.0) -> None:
    """Draw where walls may lie, those among the sightings from `pose`: 95 % bands, so many times as wide as they are.

    A line known to (alpha, d) is known at s along it, counted from the foot of the robot's perpendicular, to a variance
    of dd - 2 s ad + s^2 aa across: a band with a waist.
    """
    label: str | None = f"walls, 95 %, {enlarged:g} times enlarged" if enlarged != 1.0 else "walls, 95 %"
    for wall in (sighting for sighting in sightings if sighting.is_wall):
        normal = np.array([math.cos(wall.z[0]), math.sin(wall.z[0])])
        along = np.array([-normal[1], normal[0]])
        s = np.linspace(*wall.extent, 25)
        (aa, ad), (_, dd) = wall.cov
        half = enlarged * _NORMAL_95 * np.sqrt(np.maximum(dd - 2.0 * s * ad + s * s * aa, 0.0))
        middle = wall.z[1] * normal + s[:, None] * along
        outline = np.concatenate([middle + half[:, None] * normal, (middle - half[:, None] * normal)[::-1]])
        ax.fill(*(pose @ outline).T, color=LANDMARK, alpha=0.3, linewidth=0.0, zorder=3, label=label)
        label = None
    label_plane(ax)
