"""Figures of a run; each function draws on the axes it is given."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.geometry import Array, Pose
from sixthsense.trace import Trace

# Okabe and Ito's palette: told apart by the colour-blind too.
TRUTH, ESTIMATE, ODOMETRY, LANDMARK, PLAN = "#000000", "#0072B2", "#E69F00", "#D55E00", "#009E73"
WALL, FREE = "#56B4E9", "#F0F0F0"

CHI2_95 = 5.991  # 2 degrees of freedom


def ellipse(mean: Array, cov: Array, points: int = 48) -> Array:
    """(points, 2) on the 95 % ellipse of a (2,) mean and a (2, 2) covariance."""
    values, vectors = np.linalg.eigh(cov)
    angle = np.linspace(0.0, 2.0 * math.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(mean + circle * np.sqrt(CHI2_95 * np.maximum(values, 0.0)) @ vectors.T)


def draw_grid(ax: Any, trace: Trace) -> None:
    """Draw what the grid holds: seen area light, obstacles dark."""
    assert trace.grid is not None
    occupancy = trace.grid.occupancy()
    known = occupancy >= 0
    if not known.any():
        return
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    part = occupancy[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    shade = np.select([part == 100, part == 0], [0.35, 0.93], 1.0)
    cell, (x0, y0) = trace.config.grid.cell_m, trace.grid.origin
    extent = (
        x0 + cols[0] * cell,
        x0 + (cols[-1] + 1) * cell,
        y0 + rows[0] * cell,
        y0 + (rows[-1] + 1) * cell,
    )
    ax.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent, interpolation="nearest", zorder=0)


def draw_segments(ax: Any, segments: Array, **style: Any) -> None:
    """Draw (N, 2, 2) segments as one collection."""
    from matplotlib.collections import LineCollection

    ax.add_collection(LineCollection(list(segments), **style))


def walls_found(trace: Trace) -> Array:
    """(N, 2, 2) fitted walls of all key scans, placed by the final trajectory, world frame."""
    placed = [Pose.from_array(pose) @ walls for pose, walls in zip(trace.trajectory, trace.walls_found, strict=True)]
    return np.concatenate([np.zeros((0, 2, 2)), *placed])


def draw_map(ax: Any, trace: Trace) -> None:
    """Draw truth, estimate, landmarks with 95 % ellipses, walls found, and the path planned and driven."""
    from matplotlib.collections import PolyCollection

    draw_grid(ax, trace)
    draw_segments(ax, walls_found(trace), colors=WALL, linewidths=0.6, alpha=0.35, label="walls found", zorder=1)
    if trace.scene is not None:
        draw_segments(ax, trace.scene.walls, colors=TRUTH, linewidths=1.0, label="walls, true", zorder=2)
    for k, plan in enumerate(trace.plans):
        label = "planned" if k == 0 else None
        ax.plot(plan[:, 0], plan[:, 1], color=PLAN, linewidth=0.8, linestyle="--", alpha=0.7, label=label, zorder=3)
    odometry = np.array(trace.odometry).reshape(-1, 3)
    ax.plot(odometry[:, 0], odometry[:, 1], color=ODOMETRY, linewidth=0.8, label="dead reckoning", zorder=3)
    estimates = np.array(trace.estimates).reshape(-1, 3)
    if trace.truths:
        truth = np.array(trace.truths)
        ax.plot(truth[:, 0], truth[:, 1], color=TRUTH, linewidth=1.6, label="driven, true", zorder=4)
    ax.plot(estimates[:, 0], estimates[:, 1], color=ESTIMATE, linewidth=1.0, label="driven, estimated", zorder=5)
    landmarks = trace.final.landmarks
    if len(landmarks):
        outlines = [
            ellipse(mean, trace.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k])
            for k, mean in enumerate(landmarks)
        ]
        ax.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=LANDMARK, linewidths=0.9, zorder=6))
        label = "landmarks, 95 %"
        ax.scatter(landmarks[:, 0], landmarks[:, 1], s=6, color=LANDMARK, label=label, zorder=6)
    if len(estimates):
        ax.plot(estimates[0, 0], estimates[0, 1], "o", color=ESTIMATE, markersize=6, label="start", zorder=7)
        ax.plot(estimates[-1, 0], estimates[-1, 1], "s", color=ESTIMATE, markersize=6, label="end", zorder=7)
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.autoscale_view()


def save_map(trace: Trace, file: Path, title: str) -> None:
    """Write the map figure as an image."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Without pyplot no window system is asked for and no global state is touched.
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    draw_map(ax, trace)
    ax.set_title(title)
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    file.parent.mkdir(exist_ok=True)
    figure.savefig(file, dpi=130)
