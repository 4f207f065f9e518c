"""Where a figure is drawn: a new picture, or axes that the caller has; its legend, its window, its slider."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import shown
from sixthsense.core.geometry import Array
from sixthsense.figures.plot import draw_segments, label_plane, new_figure
from sixthsense.simulation.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from sixthsense.core.picture import Picture
    from sixthsense.evaluation.curves import Over

    OnAxes = Axes | Sequence[Axes] | NDArray[Any]

WIDTH_IN = 11.0
"""of most figures"""

_SHORT_M = 0.1  # lengths below are read in millimetres


class Canvas:
    """A picture that is made when its panels are asked for, or the caller's axes in its place."""

    def __init__(self, what: str, kinds: Sequence[str], over: Over = "time", ax: Any = None) -> None:
        """Of the figure named `what`, one of `kinds`, over an axis; `ax` is one Axes of matplotlib or several.

        Without `ax` the picture is new. Raises InputError for a figure that is none of these kinds, for an axis that
        it is not drawn over, and for what is no Axes.
        """
        if what not in kinds:
            raise InputError("what", f"found {shown(what)}", ", ".join(kinds), nearest(what, kinds))
        axes = ("time", "distance") if what in ("error", "nees") else ("time",)
        if over not in axes:
            raise InputError("over", f"found {shown(over)} for {what}", f"{', '.join(axes)}")
        self.what, self.over = what, over
        self.given = None if ax is None else _axes(ax)
        self.picture = new_figure(WIDTH_IN, WIDTH_IN) if ax is None else None

    @property
    def is_one(self) -> bool:
        """Whether the caller has given a single Axes, on which some figures draw their main panel alone."""
        return self.given is not None and len(self.given) == 1

    def panels(self, rows: int, columns: int, width_in: float, height_in: float, **share: Any) -> list[Any]:
        """The axes of the figure, row by row; InputError if the caller has given another number of them."""
        if self.picture is not None:
            self.picture.set_size_inches(width_in, height_in)
            return list(self.picture.subplots(rows, columns, squeeze=False, **share).ravel())
        assert self.given is not None
        if len(self.given) != rows * columns:
            raise InputError("ax", f"found {len(self.given)} axes for {self.what}", f"{rows * columns}")
        return self.given

    def entitle(self, title: str, subtitle: str = "") -> None:
        """End a figure: write the title over the picture, on the caller's axes a short one over the first without one.

        Short lengths are in millimetres from then on.
        """
        for ax in (self.given or []) if self.picture is None else self.picture.axes:
            in_millimetres(ax)
        if self.picture is not None:
            self.picture.suptitle(f"{title}\n{subtitle}" if subtitle else title, fontsize=10.5 if subtitle else 12.0)
        elif self.given is not None and not self.given[0].get_title():
            short = [title.partition(":")[0], subtitle.partition(" — ")[0]] if subtitle else [title]
            self.given[0].set_title("\n".join(short), fontsize=9)

    def label(self, ax: Any) -> None:
        """Add the legend of one panel: above it in a picture, inside on the caller's axes."""
        names = ax.get_legend_handles_labels()[1]
        if not names:
            return
        if self.given is not None:
            ax.legend(frameon=False, fontsize="small")
            return
        columns = max(1, min(4, 120 // (max(map(len, names)) + 8)))
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.2)

    def label_below(self, panels: list[Any]) -> None:
        """Add one legend for all panels: below them in a picture, inside the first of the caller's axes."""
        if self.picture is None:
            self.label(panels[0])
            return
        names = [name for ax in panels for name in ax.get_legend_handles_labels()[1]]
        legend(self.picture, max(1, min(5, 130 // (max(map(len, names), default=0) + 8))))


def in_millimetres(ax: Any) -> None:
    """Label the vertical axis in millimetres, if it is one of metres and all of it is below 0.1 m."""
    from matplotlib.ticker import Formatter

    label, most = ax.get_ylabel(), max(map(abs, ax.get_ylim()))
    if label.endswith("[m]") and label != "y [m]" and most < _SHORT_M:
        ax.set_ylabel(label.removesuffix("[m]") + "[mm]")
        ax.yaxis.set_major_formatter(lambda value, _: Formatter.fix_minus(f"{1e3 * value:.4g}"))


def _axes(ax: Any) -> list[Any]:
    """The caller's axes as a list; InputError for anything else."""
    found = list(ax.ravel()) if hasattr(ax, "ravel") else list(ax) if isinstance(ax, Iterable) else [ax]
    if not found or not all(hasattr(one, "get_legend_handles_labels") for one in found):
        raise InputError("ax", f"found {shown(ax)}", "Axes of matplotlib, one or several")
    return found


def new_axes(rows: int, columns: int, width_in: float, height_in: float, **share: Any) -> tuple[Picture, list[Any]]:
    """A new figure and its axes, row by row; `sharex` and `sharey` as of matplotlib's `subplots`."""
    figure = new_figure(width_in, height_in)
    return figure, list(figure.subplots(rows, columns, squeeze=False, **share).ravel())


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


def slider(draw: Callable[[Any], Any], values: Sequence[Any], start: Any, label: str) -> None:
    """Display `draw(start)` below a slider over `values` that draws again; without ipywidgets the picture alone.

    Raises ValueError for a `start` that is none of the values. Needs IPython, as every notebook does.
    """
    from IPython import display as showing

    display: Any = showing.display
    if start not in values:
        raise ValueError(f"start: found {start!r}, allowed: {', '.join(map(str, values))}")
    try:
        from ipywidgets import SelectionSlider
    except ImportError:
        display(draw(start))
        return
    moved = SelectionSlider(options=list(values), value=start, description=label, continuous_update=False)
    display(moved)
    shown = display(draw(start), display_id=True)
    moved.observe(lambda change: shown.update(draw(change["new"])), names="value")
