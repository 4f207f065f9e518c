"""Layout of figures: several axes, one legend, true walls in the background, and a window of the plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.figures.plot import draw_segments, label_plane, new_figure
from sixthsense.sources.scene import Scene


def new_axes(
    rows: int, columns: int, width_in: float, height_in: float, sharex: bool = False, sharey: bool = False
) -> tuple[Any, list[Any]]:
    """A new figure and its axes, row by row."""
    figure = new_figure(width_in, height_in)
    return figure, list(figure.subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False).ravel())


def legend(figure: Any, columns: int = 6) -> Any:
    """Add one legend for all axes below them, and return the figure."""
    entries = {
        label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def draw_truth(ax: Any, scene: Scene, color: str = "#C8C8C8", near: Array | None = None, reach_m: float = 0.0) -> None:
    """Draw the true walls and show all of them, or a window of `reach_m` around the point `near` (2,)."""
    draw_segments(ax, scene.walls, colors=color, linewidths=1.4, zorder=0.5, label="true walls")
    label_plane(ax)
    low, high = scene.walls.reshape(-1, 2).min(axis=0) - 0.4, scene.walls.reshape(-1, 2).max(axis=0) + 0.4
    if near is not None:
        low, high = np.maximum(low, near - reach_m), np.minimum(high, near + reach_m)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def window(ax: Any, points: Array) -> None:
    """Show (N, 2) points with a margin of a metre in a window of aspect 4 to 3."""
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    centre, half = 0.5 * (low + high), 0.5 * max(high[0] - low[0], (high[1] - low[1]) * 4 / 3)
    ax.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - 0.75 * half, centre[1] + 0.75 * half))
