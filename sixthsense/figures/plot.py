"""Colours, the map and basic drawing functions; each draws on given axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.geometry import Array, Pose
from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.navigation.frontier import frontier_points
from sixthsense.record.exports import known_part
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import BODY_M

if TYPE_CHECKING:
    from sixthsense.core.picture import Picture

# Okabe and Ito's palette, which colour-blind people can distinguish.
TRUTH = "#000000"
ESTIMATE = "#0072B2"
ODOMETRY = "#E69F00"
LANDMARK = "#D55E00"
PLAN = "#009E73"
WALL = "#4D4D4D"
WALL_FOUND = "#CC79A7"
OBSERVATION = "#56B4E9"
SEEN = "#D3E9F7"
WALKER = "#882255"
DOUBT = "#CC0000"
CYCLE = (ESTIMATE, LANDMARK, PLAN, WALL_FOUND, ODOMETRY, OBSERVATION, TRUTH)
"""Colours of numbered items such as runs and partitions."""

_MOST_CAUSES = 5  # marked on a map

CHI2_95 = 5.991  # 2 degrees of freedom

MAP_WIDTH_IN = 11.0
"""of a single map"""
_LEAST_HEIGHT_IN, _MOST_HEIGHT_IN = 1.5, 11.0
_DPI = 130  # of a bitmap
_FRAME_IN = 1.0  # height of title, axis label and legend
_MOST_BLOCKS = round(MAP_WIDTH_IN * _DPI)  # along a side of the drawn grid: pixels of a bitmap


def ellipse(mean: Array, cov: Array, points: int = 48) -> Array:
    """(points, 2) on the 95 % ellipse of a mean (2,) and a covariance (2, 2)."""
    values, vectors = np.linalg.eigh(cov)
    angle = np.linspace(0.0, 2.0 * math.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(mean + circle * np.sqrt(CHI2_95 * np.maximum(values, 0.0)) @ vectors.T)


def known_blocks(
    trace: Trace, most: int | None = None
) -> tuple[NDArray[np.int8], tuple[float, float, float, float]] | None:
    """The occupancy within the bounds of the known cells, and its extent: left, right, bottom, top, metres.

    In square blocks of cells where they are more than `most` along a side: a block with an obstacle is one, and one
    with a free cell is free. Blocks begin at multiples of their side, so that they stay where they are when the map
    grows. None for a trace without a grid, or without a known cell.
    """
    if trace.grid is None:
        return None
    known = known_part(trace.grid.occupancy(), trace.grid.origin, trace.config.grid.cell_m)
    if known is None or most is None or max(known[0].shape) <= most:
        return known
    blocks, (left, _, bottom, _) = known
    cell_m, side = trace.config.grid.cell_m, -(-max(blocks.shape) // most)
    row, col = (round(edge / cell_m) % side for edge in (bottom, left))
    for axis, before in enumerate((row, col)):
        begins = np.maximum(np.arange(-before, blocks.shape[axis], side), 0)
        blocks = np.maximum.reduceat(blocks, begins, axis=axis)
    (height, width), left, bottom = blocks.shape, left - col * cell_m, bottom - row * cell_m
    return blocks, (left, left + width * side * cell_m, bottom, bottom + height * side * cell_m)


def draw_grid(ax: Any, trace: Trace, seen: str, obstacle: str) -> Array:
    """Draw the grid, if the trace has one: seen cells and obstacles in these colours, others transparent.

    Returns places of the obstacles, (N, 2).
    """
    from matplotlib.colors import ListedColormap

    # Matplotlib takes some 20 bytes for each cell that it is given, 100 where it interpolates colours, and shows
    # no more than there are pixels.
    known = known_blocks(trace, _MOST_BLOCKS)
    if known is None:
        return np.zeros((0, 2))
    cells, (left, right, bottom, top) = known
    shown = np.select([cells == 100, cells == 0], [2, 1], 0).astype(np.uint8)
    style = {"origin": "lower", "interpolation": "nearest", "interpolation_stage": "data", "zorder": 0}
    ax.imshow(shown, cmap=ListedColormap(["none", seen, obstacle]), vmin=0, vmax=2, extent=known[1], **style)
    sides = (right - left) / cells.shape[1], (top - bottom) / cells.shape[0]
    return np.asarray((left, bottom) + np.argwhere(cells == 100)[:, ::-1] * sides)


def draw_segments(ax: Any, segments: Array, **style: Any) -> None:
    """Draw (N, 2, 2) segments as one collection."""
    from matplotlib.collections import LineCollection

    ax.add_collection(LineCollection(list(segments), **style))


def walls_found(trace: Trace, poses: Sequence[Array] | Array) -> Array:
    """(N, 2, 2) detected walls of all keyframes, world frame, placed by `poses` (K, 3) of the keyframes."""
    placed = [Pose.from_array(pose) @ walls for pose, walls in zip(poses, trace.walls_found, strict=True)]
    return np.concatenate([np.zeros((0, 2, 2)), *placed])


def landmarks_of(trace: Trace) -> tuple[Array, Array, list[Array]]:
    """Points (N, 2) of a run's newest map, their covariances (N, 2, 2), and the ends (2, 2) of each wall's seen part.

    The map is that of the last keyframe; of a run that is over the final one.
    """
    live = trace.live
    if live is None:
        estimate, records = trace.final, trace.records
        covs = landmark_covariances(trace.joint_cov)[~estimate.walls]
    elif trace.key_estimates:
        estimate, records = trace.key_estimates[-1], dict(live.records)
        covs = live.point_covariances(estimate)
    else:
        return np.zeros((0, 2)), np.zeros((0, 2, 2)), []
    extents = [records[i].extent for i in estimate.ids[estimate.walls].tolist() if i in records]
    return estimate.landmarks[~estimate.walls], covs, extents


def draw_landmarks(ax: Any, trace: Trace, enlarged: float = 1.0) -> None:
    """Draw the landmarks with their 95 % ellipses, `enlarged` by a factor."""
    from matplotlib.collections import PolyCollection

    points, covs, extents = landmarks_of(trace)
    if extents:
        draw_segments(ax, np.array(extents), colors=LANDMARK, linewidths=1.2, label="estimated walls", zorder=4)
    if len(points) == 0:
        return
    outlines = [ellipse(mean, enlarged**2 * cov) for mean, cov in zip(points, covs, strict=True)]
    ax.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=LANDMARK, linewidths=0.9, zorder=6))
    label = "landmarks, 95 %" + (f", enlarged {enlarged:g} times" if enlarged != 1.0 else "")
    ax.scatter(points[:, 0], points[:, 1], s=6, color=LANDMARK, label=label, zorder=6)


def outline(pose: Pose, radius_m: float) -> Array:
    """A line (33, 2): the circle of a round body, from its middle by where it looks to."""
    angle = np.linspace(0.0, 2.0 * math.pi, 32)
    return pose @ np.vstack([np.zeros((1, 2)), radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)])


def walker_outlines(poses: Array) -> list[Array]:
    """The outline (33, 2) of each person at (N, 3) poses."""
    return [outline(Pose.from_array(pose), BODY_M) for pose in poses]


def draw_walkers(ax: Any, trace: Trace) -> None:
    """Draw the tracks of people, and where they were at last."""
    if not trace.walkers:
        return
    for track in np.array(trace.walkers).transpose(1, 0, 2):  # (S, 3)
        ax.plot(track[:, 0], track[:, 1], color=WALKER, linewidth=0.5, alpha=0.35, zorder=2)
    ax.plot([], [], color=WALKER, linewidth=1.0, label="people, true")
    draw_segments(ax, np.array(walker_outlines(trace.walkers[-1])), colors=WALKER, linewidths=1.2, zorder=6)


def label_plane(ax: Any) -> None:
    """Label axes in metres and give them equal aspect."""
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")


def draw_map(ax: Any, trace: Trace) -> None:
    """Draw truth, estimate, landmarks with 95 % ellipses, detected walls, and planned and driven paths.

    Without walls, as from scan matching, the grid's obstacles are dark, and the path is that of the final poses.
    """
    found = walls_found(trace, trace.trajectory)
    obstacles = draw_grid(ax, trace, "0.94", "0.7" if len(found) else "0.2")
    if trace.scene is not None:
        draw_segments(ax, trace.scene.walls, colors=WALL, linewidths=2.0, label="true walls", zorder=1)
    # The more scans, the fainter their walls, so that thousands of them do not hide everything else.
    style = {"colors": WALL_FOUND, "linewidths": 0.7, "alpha": min(1.0, 15.0 / (1.0 + len(trace.trajectory)) ** 0.5)}
    if len(found):
        draw_segments(ax, found, label="detected walls", zorder=2, **style)
    for k, plan in enumerate(reversed(trace.plans)):
        # Earlier plans, each replaced by the next one, stay in the background.
        last = {"linewidth": 1.0, "linestyle": "--", "label": "last planned path"}
        ax.plot(*plan.T, color=PLAN, zorder=3, **({"linewidth": 0.4, "alpha": 0.25} if k else last))
    draw_walkers(ax, trace)
    odometry = _as_path(trace.odometry, trace)[:, :2]
    ax.plot(*odometry.T, color=ODOMETRY, linewidth=0.8, label="dead reckoning", zorder=3)
    has_final = len(found) == 0 and min(trace.last_key, default=-1) >= 0  # a keyframe before every scan
    estimates = trace.scan_poses() if has_final else np.array(trace.estimates).reshape(-1, 3)
    if trace.truths:
        style = {"linewidth": 1.2, "linestyle": (0, (4, 4)), "zorder": 6}
        ax.plot(*_as_path(trace.truths, trace)[:, :2].T, color=TRUTH, label="true path", **style)
    path = _as_path(estimates, trace)[:, :2]
    ax.plot(*path.T, color=ESTIMATE, linewidth=1.4, label="estimated path", zorder=5)
    landmarks = trace.final.landmarks[~trace.final.walls]
    if len(trace.final.ids):
        draw_landmarks(ax, trace)
    if len(estimates):
        style = {"color": ESTIMATE, "markersize": 7, "markeredgewidth": 1.6, "linestyle": "none", "zorder": 7}
        ax.plot(*estimates[0, :2], marker="o", markerfacecolor="white", label="start", **style)
        ax.plot(*estimates[-1, :2], marker="s", label="end", **style)
    _draw_causes(ax, trace)
    label_plane(ax)
    _frame(ax, [estimates[:, :2], landmarks, obstacles, *(() if trace.scene is None else trace.scene.walls)])


def _draw_causes(ax: Any, trace: Trace) -> None:
    """Mark the places where something speaks against the map."""
    causes = [] if trace.verdict is None else [cause for cause in trace.verdict.causes if len(cause.places)]
    for k, cause in enumerate(causes[:_MOST_CAUSES]):
        style = {"color": DOUBT, "linestyle": "none", "marker": "ospD^"[k], "zorder": 8}
        label = f"{cause.name}, {cause.from_s:.0f} s"
        ax.plot(*cause.places.T, label=label, markersize=13, markerfacecolor="none", markeredgewidth=1.6, **style)


def _as_path(poses: ArrayLike, trace: Trace) -> Array:
    """(S + gaps, 3) poses of scans, with a gap where the robot was carried."""
    rows = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    return np.insert(rows, trace.carried_scans(), np.nan, axis=0)


def _frame(ax: Any, points: list[Array]) -> None:
    """Show the whole map, and of the dead reckoning only the part close to it; nothing of a run without a scan."""
    low, high = np.array(ax.dataLim.min), np.array(ax.dataLim.max)
    if not np.isfinite([low, high]).all():
        return
    inner = np.concatenate([np.zeros((0, 2)), *points])
    if len(inner):
        slack = 0.15 * (inner.max(axis=0) - inner.min(axis=0)).max() + 0.5
        low, high = np.maximum(low, inner.min(axis=0) - slack), np.minimum(high, inner.max(axis=0) + slack)
    margin = 0.02 * (high - low).max()
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))


def shade(
    ax: Any, mask: NDArray[np.bool_], origin: tuple[float, float], cell_m: float, color: str, zorder: float
) -> None:
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


def frontiers(trace: Trace) -> Array:
    """(N, 2) frontier cells around the robot: free ones next to an unseen one in the region, in pieces longer than it.

    World frame, metres. (0, 2) for a trace without a grid.
    """
    if trace.grid is None:
        return np.zeros((0, 2))
    region = trace.config.region or (trace.scene.region if trace.scene is not None else None)
    at, margin_m = np.array(trace.estimates[-1])[:2], trace.config.explore.margin_m
    return frontier_points(trace.grid, trace.config.grid.cell_m, region, margin_m, at, trace.radius_m)


def draw_exploration(ax: Any, trace: Trace) -> None:
    """Draw the seen area, remaining frontiers, planned paths (pale to dark over time), and places left unseen."""
    assert trace.grid is not None
    grid, cell_m = trace.grid, trace.config.grid.cell_m
    seen = grid.seen
    if trace.scene is not None:
        draw_segments(ax, trace.scene.walls, colors=WALL, linewidths=1.6, label="true walls", zorder=2)
    for k, plan in enumerate(trace.plans):
        age = (k + 1) / len(trace.plans)
        label = "planned paths, pale to dark over time" if k == len(trace.plans) - 1 else None
        ax.plot(plan[:, 0], plan[:, 1], color=PLAN, linewidth=0.8, alpha=0.15 + 0.7 * age, label=label, zorder=3)
    driven = np.array(trace.estimates).reshape(-1, 3)
    ax.plot(driven[:, 0], driven[:, 1], color=ESTIMATE, linewidth=1.4, label="estimated path", zorder=4)
    ax.plot(*driven[0, :2], marker="o", markersize=7, color=ESTIMATE, markerfacecolor="white", zorder=7)
    if len(points := frontiers(trace)):
        label = "frontiers not worth a view" if trace.outcome == "explored" else "remaining frontiers"
        ax.scatter(points[:, 0], points[:, 1], s=4.0, color=LANDMARK, label=label, zorder=6)
    if trace.left:
        left = np.array([(place.x, place.y) for place in trace.left])
        ax.scatter(left[:, 0], left[:, 1], s=60.0, marker="x", color=LANDMARK, label="places left unseen", zorder=8)
    shade(ax, seen, grid.origin, cell_m, SEEN, 0.1)
    shade(ax, grid.obstacles, grid.origin, cell_m, OBSERVATION, 0.2)
    label_plane(ax)
    shown = np.concatenate([driven[:, :2], *(() if trace.scene is None else trace.scene.walls)])
    low, high = shown.min(axis=0) - 0.5, shown.max(axis=0) + 0.5
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def new_figure(width_in: float, height_in: float) -> Picture:
    """An empty figure without window system and global state, unlike pyplot's."""
    from sixthsense.core.picture import Picture

    return Picture(width_in, height_in)


def save(figure: Any, file: Path | str) -> None:
    """Write a figure as a bitmap, or as vector graphics for .svg and .pdf; a missing folder is made."""
    from sixthsense.core.picture import MARGIN_IN, Picture

    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(figure, Picture) and file.suffix not in (".svg", ".pdf"):
        figure.save_bitmap(file, _DPI)
    else:
        figure.savefig(file, dpi=_DPI, bbox_inches="tight", pad_inches=MARGIN_IN)


def map_height(ax: Any, width_in: float) -> float:
    """Height, inches, of a map of a given width, with frame and legend, within fixed bounds."""
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    return float(min(max(width_in * (y1 - y0) / (x1 - x0), _LEAST_HEIGHT_IN), _MOST_HEIGHT_IN) + _FRAME_IN)


def save_map(run: MeasuredRun | Trace, file: Path | str, title: str | None = None) -> None:
    """Write the map as a PNG whose height follows from the shape of the map; a missing folder is made."""
    trace = run.trace if isinstance(run, MeasuredRun) else run
    save(map_figure(trace, trace.outcome if title is None else title), file)


def map_figure(trace: Trace, title: str, width_in: float = MAP_WIDTH_IN, legend: bool = True) -> Picture:
    """The map as a new figure, whose height follows from the shape of the map."""
    figure = new_figure(width_in, width_in)
    ax = figure.add_subplot()
    draw_map(ax, trace)
    figure.set_size_inches(width_in, map_height(ax, width_in))
    ax.set_title(title)
    if legend:
        figure.legend(loc="outside lower center", ncols=5, frameon=False)
    return figure
