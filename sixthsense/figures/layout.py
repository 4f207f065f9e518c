"""What figures share: axes side by side, one legend, the true walls behind, and a window to look through."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.figures.plot import draw_segments, label_plane, new_figure
from sixthsense.sources.scene import Scene


def new_axes(
    rows: int, columns: int, width_in: float, height_in: float, sharex: bool = False, sharey: bool = False
) -> tuple[Any, list[Any]]:
    """A figure and its axes, row by row."""
    figure = new_figure(width_in, height_in)
    return figure, list(figure.subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False).ravel())


def legend(figure: Any, columns: int = 6) -> Any:
    """Give a figure one legend for all its axes, below them; the figure."""
    entries = {
        label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def draw_truth(ax: Any, scene: Scene, color: str = "#C8C8C8", near: Array | None = None, reach_m: float = 0.0) -> None:
    """Draw the true walls, all of them or what lies within `reach_m` of the (2,) point `near`."""
    draw_segments(ax, scene.walls, colors=color, linewidths=1.4, zorder=0.5, label="walls, true")
    label_plane(ax)
    low, high = scene.walls.reshape(-1, 2).min(axis=0) - 0.4, scene.walls.reshape(-1, 2).max(axis=0) + 0.4
    if near is not None:
        low, high = np.maximum(low, near - reach_m), np.minimum(high, near + reach_m)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def window(ax: Any, points: Array) -> None:
    """Look at (N, 2) points and a metre around them, in a window of 4 to 3."""
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    centre, half = 0.5 * (low + high), 0.5 * max(high[0] - low[0], (high[1] - low[1]) * 4 / 3)
    ax.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - 0.75 * half, centre[1] + 0.75 * half))
