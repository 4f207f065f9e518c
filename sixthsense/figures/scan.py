"""Figures of one scan: its processing (report figures 2, 3, 4, 11), its settings, and a filter's state after it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.landmarks import Observation
from sixthsense.core.laser import Scan
from sixthsense.figures.plot import (
    CHI2_95,
    CYCLE,
    ESTIMATE,
    LANDMARK,
    OBSERVATION,
    PLAN,
    WALL_FOUND,
    draw_segments,
    ellipse,
    label_plane,
)
from sixthsense.simulation.scene import Scene
from sixthsense.slam.features import Features
from sixthsense.slam.features.partition import Indices

_RETURN = "#666666"
_NORMAL_95 = 1.96  # sigmas
_SAME_POINT_M = 0.15  # largest distance of two observations of the same landmark
_SAME_WALL_M = 0.1  # largest distance of a wall's middle and quarter points from walls of the other set


def _points(pose: Pose, scan: Scan) -> Array:
    """(N, 2) end points of the beams, world frame; NaN for a beam without a return."""
    points = np.where(np.isfinite(scan.ranges)[:, None], scan.points_robot, np.nan)
    return pose @ points


def draw_beams(ax: Any, pose: Pose, scan: Scan, color: str = LANDMARK) -> None:
    """Draw the beams of a scan taken at `pose`; those without a return up to the maximum range."""
    lengths = np.where(np.isfinite(scan.ranges), scan.ranges, scan.max_range).astype(np.float64)
    T_world_laser = pose @ scan.T_robot_laser
    bearings = scan.bearings
    ends = T_world_laser @ np.stack([lengths * np.cos(bearings), lengths * np.sin(bearings)], axis=1)
    starts = np.broadcast_to(T_world_laser.position, ends.shape)
    style = {"colors": color, "linewidths": 0.3, "alpha": 0.6, "zorder": 1}
    draw_segments(ax, np.stack([starts, ends], axis=1), label="beams", **style)
    label_plane(ax)


def draw_returns(ax: Any, pose: Pose, scan: Scan, color: str = _RETURN, size: float = 4.0) -> None:
    """Draw the returns of a scan taken at `pose`."""
    points = _points(pose, scan)
    ax.scatter(points[:, 0], points[:, 1], s=size, color=color, linewidths=0.0, zorder=3, label="laser returns")
    label_plane(ax)


def draw_partitions(ax: Any, pose: Pose, scan: Scan, parts: Sequence[Indices], least: int = 1) -> None:
    """Draw the returns of each partition in its own colour, and all others in grey.

    Partitions with fewer than `least` returns are ignored.
    """
    points = _points(pose, scan)
    draw_returns(ax, pose, scan, color="#BBBBBB", size=3.0)
    for k, part in enumerate(part for part in parts if len(part) >= least):
        ax.scatter(*points[part].T, s=8.0, color=CYCLE[k % len(CYCLE)], linewidths=0.0, zorder=4)


def draw_detections(ax: Any, pose: Pose, features: Features, enlarged: float = 0.0) -> None:
    """Draw the walls (pink) and landmarks (cyan circles) detected in one scan from `pose`.

    With `enlarged` above 0, draw the 95 % ellipses of the observations, enlarged by this factor.
    """
    draw_segments(ax, pose @ features.walls, colors=WALL_FOUND, linewidths=2.0, zorder=4, label="detected walls")
    observations = [observation for observation in features.observations if not observation.is_wall]
    if observations:
        points = pose @ np.array([observation.z for observation in observations])
        style = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.6, "zorder": 5}
        ax.scatter(points[:, 0], points[:, 1], s=50.0, label="detected landmarks", **style)
        for k, observation in enumerate(observations if enlarged else ()):
            outline = pose @ ellipse(observation.z, enlarged**2 * observation.cov)
            label = f"95 %, enlarged {enlarged:g} times" if k == 0 else None
            ax.plot(outline[:, 0], outline[:, 1], color=LANDMARK, linewidth=0.8, zorder=6, label=label)
    label_plane(ax)


def draw_wall_bands(ax: Any, pose: Pose, observations: Sequence[Observation], enlarged: float = 1.0) -> None:
    """Draw the 95 % bands of the walls among the observations from `pose`, `enlarged` in width by a factor.

    A line with covariance [aa, ad; ad, dd] of (alpha, d) has the variance dd - 2 s ad + s^2 aa across at the distance s
    along it from the foot of the robot's perpendicular, so the band is narrowest near that point.
    """
    label: str | None = f"walls, 95 %, enlarged {enlarged:g} times" if enlarged != 1.0 else "walls, 95 %"
    for wall in (observation for observation in observations if observation.is_wall):
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


def draw_state(
    ax: Any, mean: Array, cov: Array, color: str = ESTIMATE, label: str | None = None, enlarged: float = 1.0
) -> None:
    """Draw the 95 % ellipses of the position (filled) and of all point landmarks, `enlarged` by a factor.

    The state is one Gaussian: `mean` (3 + 2n,) of x, y, theta and the n points, world frame, and its covariance.
    """
    from matplotlib.collections import PolyCollection

    points = mean[3:].reshape(-1, 2)
    outlines = [ellipse(at, enlarged**2 * own) for at, own in zip(points, landmark_covariances(cov), strict=True)]
    own = ellipse(mean[:2], enlarged**2 * cov[:2, :2])
    ax.fill(own[:, 0], own[:, 1], color=color, alpha=0.25, linewidth=0.0, zorder=9)
    ax.plot(own[:, 0], own[:, 1], color=color, linewidth=1.2, zorder=9.5, label=label)
    ax.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=color, linewidths=1.2, zorder=6))
    ax.scatter(points[:, 0], points[:, 1], s=5.0, color=color, linewidths=0.0, zorder=6)
    label_plane(ax)


def draw_innovations(ax: Any, pose: Pose, z: Array, predicted: Array, covs: Array, gate: float = CHI2_95) -> None:
    """Draw predicted observations with the gates of their innovations, and the actual observations.

    `z` (m, 2) and `predicted` (k, 2) in the robot's frame at `pose`; `covs` (k, 2, 2); a gate is the ellipse at the
    squared Mahalanobis distance `gate`.
    """
    for k, (mean, cov) in enumerate(zip(predicted, covs, strict=True)):
        outline = pose @ ellipse(mean, gate / CHI2_95 * cov)
        ax.plot(*outline.T, color=ESTIMATE, linewidth=1.1, zorder=5, label="gate" if k == 0 else None)
    ax.scatter(*(pose @ predicted).T, s=12.0, color=ESTIMATE, zorder=5, label="predicted observation")
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.8}
    ax.scatter(*(pose @ z).T, s=60.0, zorder=6, label="observation", **style)
    label_plane(ax)


def draw_correlation(ax: Any, cov: Array, title: str = "") -> None:
    """Draw the correlations of a joint covariance (3 + 2k, 3 + 2k): the pose's three rows first, then the landmarks."""
    from matplotlib import colormaps

    sigma = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    colors = colormaps["RdBu_r"].resampled(15)
    image = ax.imshow(cov / np.outer(sigma, sigma), cmap=colors, vmin=-1.0, vmax=1.0, interpolation="nearest")
    ax.figure.colorbar(image, ax=ax, shrink=0.8, label="correlation [1]")
    for lines in (ax.axhline, ax.axvline):
        lines(2.5, color="black", linewidth=0.6)
    ax.set_xticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_yticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_title(title)


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
    is_known, is_found = (gaps <= _SAME_POINT_M).any(axis=1), (gaps <= _SAME_POINT_M).any(axis=0)
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
    return (off <= _SAME_WALL_M).all(axis=1)


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
