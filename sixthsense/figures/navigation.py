"""Figures of navigation: seen and blocked cells, paths, and exploration (report figures 6 to 9)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.figures.plot import ESTIMATE, LANDMARK, OBSERVATION, PLAN, SEEN, WALL, draw_segments, label_plane
from sixthsense.navigation.frontier import frontier_points
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

_INFLATED = "#F6CFBF"


def _shade(ax: Any, mask: Bools, origin: tuple[float, float], cell_m: float, color: str, zorder: float) -> None:
    """Colour the cells of (H, W) `mask`."""
    from matplotlib.colors import to_rgba

    image = np.zeros((*mask.shape, 4))
    image[mask] = to_rgba(color)
    height, width = mask.shape
    extent = (origin[0], origin[0] + width * cell_m, origin[1], origin[1] + height * cell_m)
    limits = ax.get_xlim(), ax.get_ylim()
    ax.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=zorder)
    # The extent of a grid must not change the limits of the axes.
    ax.set(xlim=limits[0], ylim=limits[1])
    label_plane(ax)


def draw_seen(ax: Any, space: FreeSpace) -> None:
    """Colour the cells that a beam crossed or ended in: the sense grid."""
    _shade(ax, space.seen, space.origin, space.cell_m, SEEN, 0.1)


def draw_hits(ax: Any, grid: Grid, cell_m: float) -> None:
    """Colour the obstacle cells of the hit grid, and in a paler colour the inflated cells."""
    space = grid.free_space()
    _shade(ax, space.blocked, space.origin, space.cell_m, _INFLATED, 0.2)
    _shade(ax, grid.obstacles, grid.origin, cell_m, LANDMARK, 0.3)


def draw_path(ax: Any, plan: Array, optimised: Array | None = None) -> None:
    """Draw a planned path (N, 2), and if given its shortcut (M, 2) with the current way point."""
    ax.plot(plan[:, 0], plan[:, 1], color=PLAN, linewidth=1.6, zorder=5, label="planned path")
    if optimised is not None:
        ax.plot(optimised[:, 0], optimised[:, 1], color=ESTIMATE, linewidth=1.6, zorder=6, label="path after shortcut")
        style = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 2.0, "zorder": 7}
        ax.scatter(*optimised[min(1, len(optimised) - 1)], s=90.0, label="current way point", **style)
    ax.scatter(*plan[-1], s=80.0, marker="*", color=PLAN, zorder=7, label="goal")
    label_plane(ax)


def draw_robot(ax: Any, pose: Pose, radius_m: float) -> None:
    """Draw the robot as a disc with a line for its heading."""
    from matplotlib.patches import Circle

    ax.add_patch(Circle((pose.x, pose.y), radius_m, facecolor="white", edgecolor=WALL, linewidth=1.2, zorder=8))
    nose = pose.position + radius_m * np.array([math.cos(pose.theta), math.sin(pose.theta)])
    ax.plot([pose.x, nose[0]], [pose.y, nose[1]], color=WALL, linewidth=1.2, zorder=9)


def draw_exploration(ax: Any, trace: Trace) -> None:
    """Draw the seen area, remaining frontiers, planned paths (pale to dark over time), and places left unseen.

    A frontier cell is a free cell next to an unseen one within the region, in clusters of any size.
    """
    assert trace.grid is not None
    grid, cell_m = trace.grid, trace.config.grid.cell_m
    seen = grid.seen
    region = trace.config.region or (trace.scene.region if trace.scene is not None else None)
    if trace.scene is not None:
        draw_segments(ax, trace.scene.walls, colors=WALL, linewidths=1.6, label="true walls", zorder=2)
    for k, plan in enumerate(trace.plans):
        age = (k + 1) / len(trace.plans)
        label = "planned paths, pale to dark over time" if k == len(trace.plans) - 1 else None
        ax.plot(plan[:, 0], plan[:, 1], color=PLAN, linewidth=0.8, alpha=0.15 + 0.7 * age, label=label, zorder=3)
    driven = np.array(trace.estimates).reshape(-1, 3)
    ax.plot(driven[:, 0], driven[:, 1], color=ESTIMATE, linewidth=1.4, label="estimated path", zorder=4)
    ax.plot(*driven[0, :2], marker="o", markersize=7, color=ESTIMATE, markerfacecolor="white", zorder=7)
    points = frontier_points(seen, grid.obstacles, grid.origin, cell_m, region)
    if len(points):
        label = "frontiers not worth a view" if trace.outcome == "explored" else "remaining frontiers"
        ax.scatter(points[:, 0], points[:, 1], s=4.0, color=LANDMARK, label=label, zorder=6)
    if trace.left:
        left = np.array([(place.x, place.y) for place in trace.left])
        ax.scatter(left[:, 0], left[:, 1], s=60.0, marker="x", color=LANDMARK, label="places left unseen", zorder=8)
    _shade(ax, seen, grid.origin, cell_m, SEEN, 0.1)
    _shade(ax, grid.obstacles, grid.origin, cell_m, OBSERVATION, 0.2)
    label_plane(ax)
    shown = np.concatenate([driven[:, :2], *(() if trace.scene is None else trace.scene.walls)])
    low, high = shown.min(axis=0) - 0.5, shown.max(axis=0) + 0.5
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_region(ax: Any, space: FreeSpace, cells: NDArray[np.bool_]) -> None:
    """Colour a mask (H, W) of cells, such as the reachable ones, and the blocked cells."""
    _shade(ax, cells, space.origin, space.cell_m, SEEN, 0.1)
    _shade(ax, space.blocked, space.origin, space.cell_m, _INFLATED, 0.2)
